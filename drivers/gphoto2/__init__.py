"""Still cameras through libgphoto2, one process for each camera.

`worker` is that process, `process` the connection to it, `labels` the true values of its dials,
`body` the dials and the shutter, `camera` the camera for the controller, `backend` its entry point.
"""

from camctl.drivers.gphoto2.camera import Gphoto2Camera, Gphoto2Options

__all__ = ["Gphoto2Camera", "Gphoto2Options"]
