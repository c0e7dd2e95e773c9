"""Responses of real cameras, and the desired responses that a camera is to approximate."""
