"""Options of the light: how it is metered, and which controls reach an exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click

from camctl.cli.options import Decorator, option_group
from camctl.cli.parameter_types import Name


@dataclass(frozen=True)
class LightOptions:
    """How the light is metered and which controls reach an exposure."""

    mains: str | None
    use_aperture: bool
    metering: str | None
    estimate_ratios: bool

    def request_fields(self) -> dict[str, Any]:
        """Return the fields of a `CaptureRequest`."""
        return {
            "mains_hz": None if self.mains is None else float(self.mains),
            "use_aperture": self.use_aperture,
            "spend_shutter": self.metering is not None,
            "estimate_ratios": self.estimate_ratios,
        }


_METER_HELP = "Meter with full exposures on a camera that has no preview."


def light_options(*, series: bool = False) -> Decorator:
    """Return the options of `LightOptions`; with `series` --meter also says when to meter."""
    meter = (
        click.option(
            "--meter",
            "metering",
            is_flag=False,
            flag_value="once",
            type=Name("time to meter", ("once", "each")),
            metavar="[once|each]",
            help=f"{_METER_HELP}  In a series, meter once for all sets (as without --meter), or "
            "each of them.",
        )
        if series
        else click.option("--meter", "metering", flag_value="once", help=_METER_HELP)
    )
    return option_group(
        LightOptions,
        "light",
        click.option(
            "--mains",
            type=Name("mains frequency", ("50", "60")),
            metavar="50|60",
            help="Frequency in Hz of the mains that power the lamps: prefer whole flicker periods.",
        ),
        click.option(
            "--aperture",
            "use_aperture",
            is_flag=True,
            help="Also change the aperture where shutter time and gain do not reach.",
        ),
        meter,
        click.option(
            "--estimate-ratios",
            is_flag=True,
            help="Estimate the true exposures from the pixels of the frames, and compute the "
            "pictures with them; for shutters that are not exact, and for light that changes a "
            "little.",
        ),
    )
