"""`camctl alpaca`: a camera for programs of astronomers."""

from __future__ import annotations

import threading

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import print_error
from camctl.cli.parameter_types import Text
from camctl.cli.request_options import RequestOptions, request_options

_REQUEST = ("response", "gamma", "dynamic_range", "count", "ratios")


@command(
    examples=(
        ("camctl alpaca", "the simulated camera, for programs on this computer"),
        ("camctl alpaca --camera v4l2:/dev/video0 --address 0.0.0.0:11111", "for a network"),
    )
)
@options.camera_options
@request_options(*_REQUEST)
@option(
    "--address [HOST:]PORT",
    "Where the camera is served. Without HOST for this computer alone; with it, whoever reaches "
    "the address may use the camera: Alpaca has no passwords.",
    Text(),
    default="11111",
)
def alpaca(camera: CameraOptions, request: RequestOptions, address: str) -> None:
    """Serve a camera to astronomy programs by ASCOM Alpaca.

    The duration of an exposure is the shutter time of the shortest frame: what saturates it is
    white, and the other frames show what is darker. Pictures are linear in the light, in 16 bits;
    --response and --range say where they are accurate. Ends with Ctrl-C.
    """
    from camctl.adapters.alpaca import AlpacaServer

    wanted = request.request()
    with camera.in_real_time().open() as opened:
        server = AlpacaServer(opened, wanted, address)
        try:
            print_error(f"Alpaca camera at {server.site.url}api/v1/camera/0")
            threading.Event().wait()
        finally:
            server.close()
