"""Cameras and streams that OpenCV opens: webcams on any system, URLs, GStreamer pipelines."""
