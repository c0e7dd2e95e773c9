"""What the frames of one scene say of each other."""
