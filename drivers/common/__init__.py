"""What several camera drivers share."""
