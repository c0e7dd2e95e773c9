"""What a simulated sensor looks at."""
