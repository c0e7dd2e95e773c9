"""`camctl simulate`: simulated frames, and which sensor effects they include."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as, option
from camctl.cli.output import (
    format_duration,
    format_fields,
    format_number,
    format_percent,
    format_table,
    print_finding,
    print_json,
    print_text,
    print_warning,
    progress_bar,
)
from camctl.cli.parameter_types import (
    PATH,
    ListOf,
    Number,
    Ratios,
    Seconds,
    WholeNumber,
)
from camctl.cli.request_options import named
from camctl.errors import unknown_name

if TYPE_CHECKING:
    from camctl.interface.camera import Frame
    from camctl.interface.controls import Control
    from camctl.sim.camera import SimulatedCamera
    from camctl.sim.effects.budget import Decision, FramePlan
    from camctl.sim.render import Comparison

SUFFIXES = (".tiff", ".tif", ".png", ".npy")
DEFAULT_SENSOR = "complete"
"""The sensor that has the most effects."""


@dataclass(frozen=True)
class SceneOptions:
    """What the simulated camera looks at, and with which sensor; None is the default."""

    scene: str | None = declare_as(options.scene_option())
    sensor: str | None = declare_as(options.sensor_option(DEFAULT_SENSOR))
    size: str | None = declare_as(named("size"))
    seed: int | None = declare(
        "--seed N",
        "Seed of the simulated noise; the same seed gives the same frames.  [default: 0]",
        WholeNumber(least=0),
    )
    faults: str | None = declare(
        "--fault FAULT,...",
        "Faults of the simulated camera, such as unplug@3 or wrong@1=0.5 (see "
        "docs/how-to/ci.md).  [default: none]",
        click.STRING,
    )

    def camera_options(self) -> dict[str, Any]:
        """Return those that were given, by their names as options of the simulated camera."""
        values = {**vars(self), "sensor": self.sensor or DEFAULT_SENSOR}
        return {name: value for name, value in values.items() if value is not None}


scene_options = options.option_group(SceneOptions, "scenery")


@dataclass(frozen=True)
class FrameSettings:
    """The exposures of the frames: one time, several times, or a time and ratios."""

    time_s: float = declare(
        "--time SECONDS",
        "Shutter time, for example 0.01 or 1/100; the nearest that the sensor has is used.",
        Seconds(),
        default="1/100",
    )
    times_s: tuple[float, ...] | None = declare(
        "--times S1,S2,...",
        "A bracket of these shutter times, instead of --time; the time grows with their number.",
        ListOf(Seconds()),
    )
    bracket: tuple[float, ...] | None = declare(
        "--bracket R1,R2,...",
        "A bracket of these exposures relative to the shortest, which has --time.",
        Ratios(),
    )
    gain: float = declare(
        "--gain X",
        "Linear gain; the nearest that the sensor has is used.",
        Number("a positive gain", above=0),
        default="1",
    )

    def requested_times(self) -> tuple[float, ...]:
        """Return the shutter times, s; raise `UsageError` for --times beside --bracket."""
        if self.times_s is not None:
            options.refuse_together(click.get_current_context(), "--times", {"bracket"})
            return self.times_s
        return tuple(self.time_s * ratio for ratio in self.bracket or (1.0,))


frame_settings = options.option_group(FrameSettings, "settings")


@command(
    examples=(
        ("camctl simulate --scene night-street --time 4 --explain", "nearly all effects, and why"),
        ("camctl simulate --scene cloth --time 0.01 --explain", "fewer effects make a difference"),
        ("camctl simulate --sensor ideal-6 -o floor.tiff", "without noise, 6 bits"),
        (
            "camctl simulate --scene ball --time 0.02 --bracket 1,4,16 -o ball.png",
            "ball-1.png to ball-3.png",
        ),
    )
)
@scene_options
@frame_settings
@option(
    "--tolerance DN",
    "Leave out effects that together change no sample by more than this, before the ADC; the "
    "frames of a bracket share it.  0 simulates all effects.",
    Number("a tolerance of at least 0 DN", least=0),
    field="tolerance_dn",
    default=0.5,
)
@option(
    "--explain",
    "Show each effect, its bound, its time, and why it was simulated or not; and compare the "
    "frame with one that has every effect.",
)
@option(
    "-o --output FILE",
    "File for the frame: .tiff, .png or .npy; the frames of a bracket get -1, -2, ...  "
    "[default: no file]",
    PATH,
)
@options.force
@options.as_json
def simulate(
    scenery: SceneOptions,
    settings: FrameSettings,
    tolerance_dn: float,
    explain: bool,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Take one frame or a bracket with the simulated camera.

    Effects that would change no sample by more than the tolerance are left out; the output states
    how much that can change at most.
    """
    times_s = settings.requested_times()
    files = _check_files(output, len(times_s), force=force)
    from camctl.profiles.calibrated import open_camera
    from camctl.sim.camera import SimulatedCamera

    camera_options = scenery.camera_options() | {"tolerance": tolerance_dn}
    texts = {name: str(value) for name, value in camera_options.items()}
    with open_camera("sim", texts, profile="none") as camera:
        assert isinstance(camera, SimulatedCamera)
        started = time.perf_counter()
        frames = _take(camera, times_s, settings.gain, files, compare=explain)
        seconds = time.perf_counter() - started
    if as_json:
        print_json(_to_json(frames, tolerance_dn, seconds))
        return
    print_text("\n\n".join(_to_text(frame, explain=explain) for frame in frames))
    print_text("\n" + format_fields([("simulated in", format_duration(seconds))]))


@dataclass(frozen=True)
class _SimulatedFrame:
    """What is printed of one frame, and the effects that were chosen for it."""

    properties: dict[str, Any]
    plan: FramePlan
    comparison: Comparison | None


def _take(
    camera: SimulatedCamera,
    times_s: Sequence[float],
    gain: float,
    files: Sequence[Path | None],
    *,
    compare: bool,
) -> list[_SimulatedFrame]:
    """Shoot the frames at the nearest settings and write the files."""
    from camctl.interface.controls import ExposureSetting

    controls = camera.controls
    for finding in controls.findings:
        print_finding(finding)
    nearest_gain = _nearest(controls.gain, gain, "gain")
    settings = [
        ExposureSetting(_nearest(controls.time_s, time_s, "shutter time"), nearest_gain)
        for time_s in times_s
    ]
    frames = []
    with progress_bar(f"{len(settings)} frames") as bar:
        for frame, file in zip(camera.shoot(settings), files, strict=True):
            plan = camera.last_plan
            assert plan is not None
            properties = _frame_properties(frame, str(controls.layout)) | {"file": file}
            comparison = camera.compare_last() if compare else None
            frames.append(_SimulatedFrame(properties, plan, comparison))
            if file is not None:
                _write(frame, file)
            if bar is not None:
                bar(len(frames) / len(settings), "")
    return frames


def _nearest(control: Control, requested: float, name: str) -> float:
    nearest = control.nearest(requested)
    if abs(nearest - requested) > 1e-6 * requested:
        print_warning(f"the sensor has no {name} of {requested:.9g}; {nearest:.9g} is used")
    return nearest


def _to_json(
    frames: Sequence[_SimulatedFrame], tolerance_dn: float, seconds: float
) -> dict[str, Any]:
    """Return the JSON output: one frame, or a bracket with the worst decision on each effect."""
    parts = [frame.properties | frame.plan.as_data() for frame in frames]
    for part, frame in zip(parts, frames, strict=True):
        if frame.comparison is not None:
            part["compared_with_every_effect"] = frame.comparison
    whole = {"tolerance_dn": tolerance_dn, "seconds": seconds}
    if len(parts) == 1:
        return parts[0] | whole
    effects = []
    for decisions in zip(*(frame.plan.effects for frame in frames), strict=True):
        worst = max(decisions, key=lambda one: (one.ran, one.bound_dn))
        effects.append(worst.as_data())
    joint = sum(frame.plan.joint_bound_dn for frame in frames)
    return whole | {"joint_bound_dn": joint, "effects": effects, "frames": parts}


def _to_text(frame: _SimulatedFrame, *, explain: bool) -> str:
    from camctl.sim.effects.record import Lacking

    facts, plan = frame.properties, frame.plan
    simulated = [effect.name for effect in plan.effects if effect.ran]
    left_out = [effect.name for effect in plan.effects if effect.name in plan.left_out]
    unmodelled = [each.name for each in plan.effects if each.lacking is Lacking.MODEL]
    exposure = f"{format_duration(facts['time_s'])}, gain {format_number(facts['gain'], 4)}"
    rows = [
        ("frame", f"{facts['width']} x {facts['height']}, {facts['layout']}"),
        ("exposure", exposure),
        (
            "brightness",
            f"{facts['minimum']} to {facts['maximum']}, mean {format_number(facts['mean'], 4)} "
            f"(black {facts['black']}, white {facts['white']})",
        ),
        ("saturated", format_percent(facts["saturated_fraction"])),
        ("effects simulated", ", ".join(simulated)),
        ("effects left out", ", ".join(left_out) or "none"),
        ("not modelled", ", ".join(unmodelled) or "none"),
        (
            "error by those",
            f"at most {format_number(plan.joint_bound_dn, 3)} DN in any sample before the ADC "
            f"(tolerance {format_number(plan.tolerance_dn, 3)} DN)",
        ),
        ("file", "none; -o FILE writes one" if facts["file"] is None else str(facts["file"])),
    ]
    if not explain:
        return format_fields(rows)
    if frame.comparison is not None:
        rows[7:7] = _comparison_rows(frame.comparison, plan)
    lines = [_effect_line(effect, plan) for effect in plan.effects]
    header = ("effect", "simulated", "bound, DN", "time, ms", "saved, ms", "reason")
    table = format_table(header, lines, right_aligned=(2, 3, 4))
    return "\n\n".join((format_fields(rows[:4] + rows[6:]), table, _TABLE_NOTE))


_TABLE_NOTE = """\
DN: brightness levels of the sensor. The bound is the largest change of any sample if this effect
alone is left out; where wells overflow, the end of a streak of charge can change more.
Times are estimates for frames after the first, from the cost of each effect measured on one core:
the light of a scene at rest is kept, with what the optics make of it."""


def _comparison_rows(comparison: Comparison, plan: FramePlan) -> list[tuple[str, str]]:
    """Return what leaving effects out has changed in this frame, and the time that it has saved."""
    present = [e for e in plan.effects if e.ran or e.name in plan.left_out]
    whole = sum(effect.milliseconds for effect in present)
    saved = sum(effect.milliseconds for effect in present if not effect.ran)
    share = f" ({format_percent(saved / whole)})" if whole else ""
    return [
        (
            "measured change",
            f"a sample by at most {format_number(comparison.largest_dn, 3)} DN, the mean of the "
            f"frame by {format_number(comparison.mean_dn, 2)} DN, against every effect",
        ),
        (
            "time saved",
            f"{format_number(saved, 3)} of {format_number(whole, 3)} ms{share} of a frame after "
            f"the first, estimated from the costs of the effects; timed here once: "
            f"{format_duration(comparison.seconds)}, with every effect "
            f"{format_duration(comparison.everything_s)}",
        ),
    ]


def _effect_line(effect: Decision, plan: FramePlan) -> tuple[str, ...]:
    """Return a line of the table of effects."""
    bound = format_number(effect.own_dn, 3) if math.isfinite(effect.own_dn) else "unlimited"
    took = format_number(effect.milliseconds, 2)
    if effect.ran:
        return effect.name, "yes", bound, took, "", effect.why
    if effect.name in plan.left_out:
        return effect.name, "left out", bound, "", took, effect.why
    return effect.name, "absent", "", "", "", effect.why


def _check_files(output: Path | None, count: int, *, force: bool) -> list[Path | None]:
    """Return the file of each frame, None without --output; raise if one must not be written."""
    from camctl.system.files import check_new

    if output is None:
        return [None] * count
    if output.suffix.lower() not in SUFFIXES:
        raise unknown_name("file type", output.suffix or output.name, SUFFIXES)
    numbers = [""] if count == 1 else [f"-{index + 1}" for index in range(count)]
    files = [output.with_name(f"{output.stem}{number}{output.suffix}") for number in numbers]
    for file in files:
        check_new(file, overwrite=force)
    return list(files)


def _frame_properties(frame: Frame, layout: str) -> dict[str, Any]:
    pixels = frame.pixels
    rows, columns = pixels.shape[:2]
    return {
        "time_s": frame.applied.time_s,
        "gain": frame.applied.gain,
        "width": columns,
        "height": rows,
        "layout": layout,
        "black": frame.black,
        "white": frame.white,
        "minimum": int(pixels.min()),
        "mean": float(pixels.mean()),
        "maximum": int(pixels.max()),
        "saturated_fraction": float((pixels >= frame.white).mean()),
    }


def _write(frame: Frame, output: Path) -> None:
    from camctl.system.files import write_array, write_bytes

    kind = output.suffix.lower()
    if kind == ".npy":
        write_array(output, frame.pixels)
        return
    data = io.BytesIO()
    if kind == ".png":
        from camctl.system.picture_operations import png

        data.write(png(frame.pixels))
    else:
        import tifffile

        colour = "minisblack" if frame.pixels.ndim == 2 else "rgb"
        tifffile.imwrite(data, frame.pixels, photometric=colour, compression=None)
    write_bytes(output, data.getvalue())
