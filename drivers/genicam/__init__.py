"""Machine-vision cameras that speak GenICam, on GigE Vision or USB3 Vision."""

from camctl.drivers.genicam.camera import GenicamCamera
from camctl.drivers.genicam.preparation import GenicamOptions

__all__ = ["GenicamCamera", "GenicamOptions"]
