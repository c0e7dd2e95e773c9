"""Still cameras on USB that speak PTP (ISO 15740).

Rooms, each above the next: `road` finds cameras; `camera` is `camctl.camera.Camera`; `sequence`
and `shooting` take exposures and find their files, `stills` knows what the files are; `body` speaks
the dialects of `vendors`; `protocol` does transactions; `transport` moves containers.
"""

from drivers.ptp.backend import PtpBackend
from drivers.ptp.camera import PtpCamera

__all__ = ["PtpBackend", "PtpCamera"]
