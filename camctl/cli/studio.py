"""`camctl studio`: the page for a laptop, a tablet or a phone."""

from __future__ import annotations

from pathlib import Path

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.menu import menu_options, run_menu
from camctl.cli.options import CameraOptions, option
from camctl.cli.parameter_types import Text
from camctl.cli.request_options import RequestOptions


@command(
    examples=(
        ("camctl studio", "on http://127.0.0.1:8080, with the simulated camera"),
        ("camctl studio --camera v4l2:/dev/video0 -o pictures", "a real camera"),
        (
            "CAMCTL_STUDIO_TOKEN=LONG-SECRET camctl studio --address 0.0.0.0:8080",
            "for a phone in the same network: open http://HOST:8080/?token=LONG-SECRET",
        ),
    )
)
@options.camera_options
@option(
    "--address [HOST:]PORT",
    "Where the page is served. A host that others reach needs a token in CAMCTL_STUDIO_TOKEN.",
    Text(),
    default="8080",
)
@menu_options
def studio(
    camera: CameraOptions,
    address: str,
    request: RequestOptions,
    parent: Path,
    settings: Path | None,
) -> None:
    """Choose, shoot and look at pictures in a browser: on this computer, a tablet or a phone.

    The page follows the screens of the menu, with a button for each choice. It works with keys,
    too, and from several browsers at once.
    """
    from camctl.menu.studio.panel import StudioPanel

    panel = StudioPanel(parent, address)
    run_menu(lambda: panel, camera, request, parent, settings, sight=panel.sight)
