"""`camctl simulate`: simulated frames, and which effects they have."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.capture_output import percent
from camctl.cli.commands import command
from camctl.cli.output import duration, fields, number, say, say_json, table, warn
from camctl.errors import StorageError, UsageError, unknown_name

if TYPE_CHECKING:
    from camctl.camera import Frame
    from camctl.controls import Control
    from sim.effects.budget import FramePlan

SUFFIXES = (".tiff", ".tif", ".png", ".npy")
DEFAULT_SENSOR = "complete"


class _Times(kinds.Seconds):
    """Several shutter times, parted by commas."""

    name = "times"

    def read(self, word: str, option: str) -> Any:
        """Return the times as a tuple, in the order given."""
        return tuple(super(_Times, self).read(part.strip(), option) for part in word.split(","))


@command(
    examples=(
        ("camctl simulate --scene night-street --time 4 --explain", "what it takes, and why"),
        ("camctl simulate --scene ramp --time 0.001 --explain", "what makes no difference"),
        ("camctl simulate --sensor ideal-6 -o floor.tiff", "without noise, 6 bits"),
        ("camctl simulate --scene room --bracket 1,4,16 -o room.png", "room-1.png to room-3.png"),
    )
)
@options.scene
@click.option(
    "--sensor",
    metavar="NAME|FILE.json",
    default=DEFAULT_SENSOR,
    help="The sensor; the default has every effect.",
)
@options.size
@click.option(
    "--time",
    "time_s",
    type=kinds.Seconds(),
    default="1/100",
    metavar="SECONDS",
    help="Shutter time, for example 0.01 or 1/100; the nearest that the sensor has is taken.",
)
@click.option(
    "--times",
    "times_s",
    type=_Times(),
    metavar="S1,S2,...",
    help="A bracket of these shutter times, instead of --time.",
)
@click.option(
    "--bracket",
    type=kinds.Ratios(),
    metavar="R1,R2,...",
    help="A bracket of these exposures relative to the shortest, which has --time.",
)
@click.option(
    "--gain",
    type=kinds.Number("a positive gain", above=0),
    default=1.0,
    metavar="X",
    help="Linear gain; the nearest that the sensor has is taken.",
)
@click.option(
    "--tolerance",
    "tolerance_dn",
    type=kinds.Number("a tolerance of 0 DN or more", least=0),
    default=0.5,
    metavar="DN",
    help="Leave out effects that together change no sample by more, before the ADC; the frames of "
    "a bracket share it.  0 runs everything.",
)
@click.option("--explain", is_flag=True, help="Show each effect: its bound, and why it ran or not.")
@options.noise_seed
@click.option(
    "-o",
    "--output",
    type=kinds.PATH,
    metavar="FILE",
    help="Write the frame: .tiff, .png or .npy; those of a bracket get -1, -2, ...  "
    "[default: no file]",
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@options.as_json
def simulate(
    scene: str | None,
    sensor: str,
    size: str | None,
    time_s: float,
    times_s: tuple[float, ...] | None,
    bracket: tuple[float, ...] | None,
    gain: float,
    tolerance_dn: float,
    explain: bool,
    seed: int | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Take one frame or a bracket with the simulated camera.

    Simulates only what the scene calls for: effects that would change no sample by more than the
    tolerance are left out, and the bound on what that changes is told.
    """
    wanted_s = _wanted(time_s, times_s, bracket)
    files = _files(output, len(wanted_s), force)
    from camctl.backends import open_camera
    from camctl.controls import ExposureSetting
    from sim.camera import SimulatedCamera

    beside = options.camera_options(
        scene=scene, sensor=sensor, size=size, seed=seed, tolerance_dn=tolerance_dn
    )
    told = []
    with open_camera("sim", beside) as camera:
        assert isinstance(camera, SimulatedCamera)
        controls = camera.controls
        for note in controls.notes:
            warn(note)
        nearest_gain = _nearest(controls.gain, gain, "gain")
        settings = [
            ExposureSetting(_nearest(controls.time_s, wanted, "shutter time"), nearest_gain)
            for wanted in wanted_s
        ]
        started = time.perf_counter()
        for frame, file in zip(camera.shoot(settings), files, strict=True):
            plan = camera.last_plan
            assert plan is not None
            told.append((_facts(frame, controls.layout) | {"file": file}, plan))
            if file is not None:
                _write(frame, file)
        seconds = time.perf_counter() - started
    if as_json:
        say_json(_as_json(told, tolerance_dn, seconds))
        return
    say("\n\n".join(_as_text(facts, plan, explain) for facts, plan in told))
    say("\n" + fields([("simulated in", duration(seconds))]))


def _wanted(
    time_s: float, times_s: tuple[float, ...] | None, bracket: tuple[float, ...] | None
) -> tuple[float, ...]:
    if times_s and bracket:
        raise UsageError("--times and --bracket", hint="give one of them")
    if times_s:
        return times_s
    return tuple(time_s * ratio for ratio in bracket or (1.0,))


def _files(output: Path | None, count: int, force: bool) -> list[Path | None]:
    if output is None:
        return [None] * count
    numbers = [""] if count == 1 else [f"-{index + 1}" for index in range(count)]
    files = [output.with_name(f"{output.stem}{text}{output.suffix}") for text in numbers]
    for file in files:
        _check_output(file, force)
    return list(files)


def _as_json(
    told: Sequence[tuple[dict[str, Any], FramePlan]], tolerance_dn: float, seconds: float
) -> dict[str, Any]:
    """Return the whole: of one frame its own numbers, of a bracket those of its worst frame."""
    frames = [facts | plan.as_data() for facts, plan in told]
    whole = {"tolerance_dn": tolerance_dn, "seconds": seconds}
    if len(frames) == 1:
        return frames[0] | whole
    effects = []
    for decisions in zip(*(plan.effects for _, plan in told), strict=True):
        worst = max(decisions, key=lambda one: (one.ran, one.bound_dn))
        bound = worst.bound_dn if math.isfinite(worst.bound_dn) else None
        effects.append({"name": worst.name, "bound_dn": bound, "ran": worst.ran, "why": worst.why})
    joint = sum(plan.joint_bound_dn for _, plan in told)
    return whole | {"joint_bound_dn": joint, "effects": effects, "frames": frames}


def _as_text(facts: dict[str, Any], plan: FramePlan, explain: bool) -> str:
    ran = [effect.name for effect in plan.effects if effect.ran]
    left_out = [effect.name for effect in plan.effects if effect.name in plan.left_out]
    rows = [
        ("frame", f"{facts['width']} x {facts['height']}, {facts['layout']}"),
        ("exposure", f"{duration(facts['time_s'])}, gain {number(facts['gain'], 4)}"),
        (
            "brightness",
            f"{facts['minimum']} to {facts['maximum']}, mean {number(facts['mean'], 4)} "
            f"(black {facts['black']}, white {facts['white']})",
        ),
        ("saturated", percent(facts["saturated_fraction"])),
        ("simulated", ", ".join(ran)),
        ("left out", ", ".join(left_out) or "nothing"),
        (
            "which changes",
            f"at most {number(plan.joint_bound_dn, 3)} DN of {number(plan.tolerance_dn, 3)} "
            "allowed, in any sample, before the ADC",
        ),
        ("file", "none; -o FILE writes one" if facts["file"] is None else str(facts["file"])),
    ]
    if not explain:
        return fields(rows)
    lines = [
        (
            effect.name,
            number(effect.bound_dn, 3) if math.isfinite(effect.bound_dn) else "any",
            "ran" if effect.ran else "left out" if effect.name in plan.left_out else "absent",
            effect.why,
        )
        for effect in plan.effects
    ]
    explained = table(("effect", "at most, DN", "", ""), lines, right=(1,))
    return fields(rows[:4] + rows[6:]) + "\n\n" + explained


def _check_output(output: Path, force: bool) -> None:
    if output.suffix.lower() not in SUFFIXES:
        raise unknown_name("kind of file", output.suffix or output.name, SUFFIXES)
    if output.exists() and not force:
        raise StorageError(f"{output} exists", hint="choose another name, or say --force")


def _nearest(control: Control, wanted: float, name: str) -> float:
    nearest = control.nearest(wanted)
    if abs(nearest - wanted) > 1e-6 * wanted:
        warn(f"the sensor has no {name} of {wanted:.9g}: {nearest:.9g} is taken")
    return nearest


def _facts(frame: Frame, layout: str) -> dict[str, Any]:
    pixels = frame.pixels
    rows, columns = pixels.shape[:2]
    return {
        "time_s": frame.applied.time_s,
        "gain": frame.applied.gain,
        "width": columns,
        "height": rows,
        "layout": str(layout),
        "black": frame.black,
        "white": frame.white,
        "minimum": int(pixels.min()),
        "mean": float(pixels.mean()),
        "maximum": int(pixels.max()),
        "saturated_fraction": float((pixels >= frame.white).mean()),
    }


def _write(frame: Frame, output: Path) -> None:
    from camctl.files import write_array, write_bytes

    kind = output.suffix.lower()
    if kind == ".npy":
        write_array(output, frame.pixels)
        return
    data = io.BytesIO()
    if kind == ".png":
        import cv2

        in_order = frame.pixels if frame.pixels.ndim == 2 else frame.pixels[..., ::-1]
        data.write(cv2.imencode(".png", in_order)[1].tobytes())
    else:
        import tifffile

        colour = "minisblack" if frame.pixels.ndim == 2 else "rgb"
        tifffile.imwrite(data, frame.pixels, photometric=colour, compression=None)
    write_bytes(output, data.getvalue())
