"""Still cameras on USB and in the network that speak PTP (ISO 15740).

Layers, from the top: `backend` finds cameras on USB, and `network_backend` opens cameras in the
network; `camera` is the `camctl.Camera`; `sequence`
and `shooting` take exposures and fetch their files, of the formats in `still_formats`; `body` and
`properties` perform the operations of the tables in `dialects`, with the scales in `dials`;
`session` performs transactions; `usb_transport` and `network_transport` (with `network_link`) move
their containers, as `transport` states; `datasets` and `codes` are the data.
"""

from camctl.drivers.ptp.backend import PtpBackend
from camctl.drivers.ptp.camera import PtpCamera, PtpOptions

__all__ = ["PtpBackend", "PtpCamera", "PtpOptions"]
