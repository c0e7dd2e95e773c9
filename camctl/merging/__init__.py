"""Photographs already taken, from their files to the picture of an effective camera."""
