"""Machine-vision cameras that speak GenICam, on GigE Vision or USB3 Vision."""

from camctl.drivers.genicam.camera import GenicamCamera, GenicamOptions

__all__ = ["GenicamCamera", "GenicamOptions"]
