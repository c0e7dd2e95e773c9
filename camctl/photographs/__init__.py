"""Photographs already taken, as the frames of a camera."""
