"""The Nikon CoolPix 990 on a serial line: the camera of the paper."""

from drivers.coolpix.camera import CoolpixCamera

__all__ = ["CoolpixCamera"]
