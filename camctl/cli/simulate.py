"""`camctl simulate`: one simulated frame."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import kinds, options
from camctl.cli.commands import command
from camctl.cli.output import duration, fields, number, say, say_json, table, warn
from camctl.cli.results import percent
from camctl.errors import StorageError, unknown_name

if TYPE_CHECKING:
    from camctl.camera import Control, Frame

SUFFIXES = (".tiff", ".tif", ".png", ".npy")


@command(
    examples=(
        ("camctl simulate --time 1/100 -o floor.png", "the tile floor at 10 ms"),
        ("camctl simulate --scene ramp --sensor ideal-6 -o ramp.tiff", "without noise, 6 bits"),
        ("camctl simulate --scene memorial.hdr --gain 4 --json", "a radiance map; numbers only"),
    )
)
@options.scene
@options.sensor
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
    "--gain",
    type=kinds.Number("a positive gain", above=0),
    default=1.0,
    metavar="X",
    help="Linear gain; the nearest that the sensor has is taken.",
)
@options.noise_seed
@click.option(
    "-o",
    "--output",
    type=kinds.PATH,
    metavar="FILE",
    help="Write the frame: .tiff, .png or .npy.  [default: no file]",
)
@click.option("--force", is_flag=True, help="Replace an existing file.")
@options.as_json
def simulate(
    scene: str | None,
    sensor: str | None,
    size: str | None,
    time_s: float,
    gain: float,
    seed: int | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Take one frame with the simulated camera.

    Tells which effects of the sensor are in it and how its brightness lies between black and
    white.  Nothing that the sensor has is left out.
    """
    if output is not None:
        _check_output(output, force)
    from camctl.camera import ExposureSetting
    from camctl.registry import open_camera
    from sim.camera import SimulatedCamera

    beside = options.camera_options(scene, sensor, size, seed)
    with open_camera("sim", beside) as camera:
        assert isinstance(camera, SimulatedCamera)
        controls = camera.controls
        for note in controls.notes:
            warn(note)
        setting = ExposureSetting(
            time_s=_nearest(controls.time_s, time_s, "shutter time"),
            gain=_nearest(controls.gain, gain, "gain"),
        )
        started = time.perf_counter()
        frame = next(iter(camera.shoot([setting])))
        seconds = time.perf_counter() - started
        effects = camera.effects
    if output is not None:
        _write(frame, output)
    facts = _facts(frame, controls.layout)
    if as_json:
        # Nothing that the sensor has is left out: the frame is off by nothing.
        told = [
            {"name": each.name, "bound_dn": None if each.ran else 0.0}
            | {"ran": each.ran, "why": each.why}
            for each in effects
        ]
        say_json(
            {"tolerance_dn": 0.0, "joint_bound_dn": 0.0, "effects": told, "seconds": seconds}
            | facts
            | {"file": output}
        )
        return
    told_effects = [(each.name, "simulated" if each.ran else "none", each.why) for each in effects]
    rows = [
        ("frame", f"{facts['width']} x {facts['height']}, {facts['layout']}"),
        ("exposure", f"{duration(facts['time_s'])}, gain {number(facts['gain'], 4)}"),
        (
            "brightness",
            f"{facts['minimum']} to {facts['maximum']}, mean {number(facts['mean'], 4)} "
            f"(black {facts['black']}, white {facts['white']})",
        ),
        ("saturated", percent(facts["saturated_fraction"])),
        ("rendered in", duration(seconds)),
        ("file", "none; -o FILE writes one" if output is None else str(output)),
    ]
    say(fields(rows) + "\n\n" + table(("effect", "", ""), told_effects))


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
