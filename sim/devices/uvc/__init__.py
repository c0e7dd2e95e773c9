"""A virtual webcam (USB Video Class)."""
