"""The Nikon CoolPix 990 on a serial line: the camera of the paper.

Layers, from the top: `backend` finds cameras; `camera` is the `camctl.Camera`; `body` takes
and downloads pictures; `pictures` finds them on the card; `settings` are the registers; `sierra` is
the protocol.
"""

from camctl.drivers.coolpix.backend import CoolpixBackend
from camctl.drivers.coolpix.camera import CoolpixCamera, CoolpixOptions

__all__ = ["CoolpixBackend", "CoolpixCamera", "CoolpixOptions"]
