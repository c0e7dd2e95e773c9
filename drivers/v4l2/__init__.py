"""Webcams and machine-vision cameras through Video4Linux."""

from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options

__all__ = ["V4l2Camera", "V4l2Options"]
