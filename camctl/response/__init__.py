"""Camera responses and desired responses."""
