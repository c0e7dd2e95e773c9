"""Cameras of the Raspberry Pi through libcamera: its Python library is picamera2."""
