"""What a virtual webcam is like: its configuration."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from camctl.backends import FrameShape
from camctl.errors import UsageError, unknown_name
from sim.devices.scenery import Exposer
from sim.devices.uvc.descriptors import FORMATS


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


Rate = Annotated[float, Field(ge=1, le=240)]


class UvcConfig(BaseModel):
    """What a virtual webcam is like; all but what it looks at.

    Attributes:
        serial: its serial number
        formats: names in `sim.devices.uvc.descriptors.FORMATS`, the default first
        sizes: WIDTHxHEIGHT beside the picture's own, which comes first
        fps: frame rates, the default first
        delay: of exposure and gain, frames
        jitter: up to so many frames more, at random
        luma: range of yuyv
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    serial: str = Field(default="UVC00001", min_length=1, max_length=60, pattern=r"^[ -~]+$")
    formats: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1)] = (
        "yuyv",
        "mjpg",
    )
    sizes: Annotated[tuple[FrameShape, ...], BeforeValidator(_listed)] = ()
    fps: Annotated[tuple[Rate, ...], BeforeValidator(_listed), Field(min_length=1)] = (10.0,)
    delay: int = Field(default=2, ge=0, le=30)
    jitter: int = Field(default=0, ge=0, le=30)
    luma: Literal["full", "limited"] = "limited"


def check_format(name: str, exposer: Exposer) -> None:
    """Refuse a pixel format that is unknown or cannot hold what the sensor gives (UsageError)."""
    if name not in FORMATS:
        raise unknown_name("pixel format", name, FORMATS)
    form, bits = FORMATS[name], exposer.sensor.bits
    if form.layout is None:
        fits = not exposer.layout.is_mosaic
    else:
        fits = form.layout is exposer.layout and bits <= form.bits
    if not fits:
        raise UsageError(
            f"{name} for a sensor of {bits} bits, {exposer.layout}",
            hint="choose another format or sensor",
        )
