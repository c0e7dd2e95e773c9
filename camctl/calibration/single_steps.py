"""Steps of a calibration: what each is given and returns, and steps that need no other result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from camctl.calibration.delay import measure_delay
from camctl.calibration.light import LONGEST_S
from camctl.calibration.noise.dark import measure_dark
from camctl.calibration.noise.pattern import (
    View,
    sensitivity_pattern,
    shoot_view,
    view_settings,
)
from camctl.calibration.noise.shooting import measure_noise
from camctl.findings import Finding
from camctl.interface.camera import Camera, StreamingCamera
from camctl.interface.controls import ExposureSetting
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.noise import DarkRecord
from camctl.profiles.profile import Profile, load_profile


def _ignore(_finding: Finding) -> None:
    pass


@dataclass(frozen=True)
class StepOptions:
    """How the steps are done.

    Attributes:
        longest_s: longest shutter time, s
        begin: called with the name of each step; returns what is called with the share of it that
            is done, 0 to 1
        warn: called with each irregularity
        cover: asks for the lens to be covered, and returns whether it was; None: it cannot be
        turn: asks for another view of the scene through the uncovered lens, and returns whether the
            camera was turned; None: it cannot be
    """

    longest_s: float = LONGEST_S
    begin: Callable[[str], Callable[[float], None] | None] = lambda _name: None
    warn: Callable[[Finding], None] = _ignore
    cover: Callable[[], bool] | None = None
    turn: Callable[[], bool] | None = None


@dataclass(frozen=True)
class StepResult:
    """What one step has measured.

    Attributes:
        name: of the step
        result: what was measured, one line; None where it could not be
        problem: why it could not be measured; None where it was
        hint, remedies: what to do then, as in `camctl.CamctlError`
    """

    name: str
    result: str | None
    problem: str | None = None
    hint: str = ""
    remedies: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """What a step has measured: the change of the profile, and one line for people."""

    keep: Callable[[Profile], None]
    text: str


Progress: TypeAlias = Callable[[float], None] | None
Measure: TypeAlias = Callable[[Camera, StepOptions, Progress], Found | None]


def delay_step(camera: Camera, options: StepOptions, progress: Progress) -> Found | None:
    """Measure the control delay of a camera that streams."""
    if not isinstance(camera, StreamingCamera):
        return None
    record = measure_delay(camera, progress=progress, warn=options.warn)
    mode = camera.mode
    if record.frames is None:
        text = f"{record.smallest} to {record.largest} frames, not constant"
    else:
        text = f"{record.frames} frame{'' if record.frames == 1 else 's'}"
    return Found(lambda profile: profile.delays.update({mode: record}), text)


def noise_step(camera: Camera, options: StepOptions, progress: Progress) -> Found:
    """Measure photon and read noise."""
    record = measure_noise(camera, longest_s=options.longest_s, progress=progress)
    for finding in record.findings:
        options.warn(finding)
    mode, measured = exposure_mode(camera.controls), record.reference
    conversion, read_noise = measured.conversion_e_per_dn, measured.read_noise_e
    text = (
        f"{conversion.value:.3g} electrons a level ({conversion.low:.3g} to "
        f"{conversion.high:.3g}), read noise {read_noise.value:.3g} electrons "
        f"({read_noise.low:.3g} to {read_noise.high:.3g}), gains measured: {len(record.gains)}"
    )
    return Found(lambda profile: profile.add_noise(mode, record), text)


class PatternSteps:
    """Measure how the sensitivity of the pixels differs, from two views of the scene.

    Between the two, the dark signal can be measured: it is then no part of the result.
    """

    def __init__(self) -> None:
        self._settings: list[ExposureSetting] = []
        self._first: View | None = None

    def first_view(self, camera: Camera, options: StepOptions, _progress: Progress) -> None:
        """Shoot the view before the camera is turned."""
        mode = exposure_mode(camera.controls)
        if options.turn is not None and mode in load_profile(camera.info).noises:
            self._settings = view_settings(camera, options.longest_s)
            self._first = shoot_view(camera, self._settings)

    def second_view(
        self, camera: Camera, options: StepOptions, _progress: Progress
    ) -> Found | None:
        """Ask for the camera to be turned, and compare both views; nothing without the first."""
        if self._first is None or options.turn is None or not options.turn():
            return None
        mode = exposure_mode(camera.controls)
        noise = load_profile(camera.info).noises[mode]
        prnu = sensitivity_pattern(self._first, shoot_view(camera, self._settings), noise)

        def keep(profile: Profile) -> None:
            profile.noises[mode] = profile.noises[mode].model_copy(update={"prnu": prnu})

        text = f"their sensitivity differs by {prnu.value:.2%} ({prnu.low:.2%} to {prnu.high:.2%})"
        return Found(keep, text)


def dark_step(camera: Camera, options: StepOptions, progress: Progress) -> Found | None:
    """Measure dark current, the pixels' offsets and hot pixels with the lens covered."""
    mode = exposure_mode(camera.controls)
    known = load_profile(camera.info).noises.get(mode)
    if options.cover is None or known is None or not options.cover():
        return None
    dark = measure_dark(camera, known, longest_s=options.longest_s, progress=progress)

    def keep(profile: Profile) -> None:
        profile.noises[mode] = profile.noises[mode].model_copy(update={"dark": dark})

    return Found(keep, dark_text(dark))


def dark_text(dark: DarkRecord) -> str:
    """Return the dark signal in words."""
    return (
        f"dark current {dark.dark_current_e_s.value:.3g} electrons/s, offsets of the pixels differ "
        f"by {dark.dsnu_e.value:.3g} electrons, hot pixels: {len(dark.hot_pixels)}"
    )
