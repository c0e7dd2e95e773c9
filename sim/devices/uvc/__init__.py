"""A virtual webcam on USB (USB Video Class)."""
