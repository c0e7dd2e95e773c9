"""Every reader of files and datasets, with valid samples that mutations start from."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tifffile

import camctl
from camctl.cli.parameter_types import Seconds, Settings
from camctl.exposure.build import Job, build_table, look_up, solve_job, table_jobs
from camctl.exposure.evaluation import evaluate
from camctl.exposure.table import ExposureTable
from camctl.interface.controls import Layout
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.measured import read_curve, read_desired, read_response_model
from camctl.profiles.folder import list_profiles
from camctl.profiles.profile import DelayRecord, Profile, StillRecord
from camctl.sim.camera import SimulatedCamera
from camctl.sim.devices.hub import read_config
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.studies.rows import read_runs
from camctl.studies.simulation_study import SimulationRun
from camctl.studies.solver_study import SolverRun

Read = Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Reader:
    """A reader of one kind of input.

    Attributes:
        samples: returns valid inputs
        read: reads an input; it may write into the folder, and raises `CamctlError` alone
    """

    samples: Callable[[], list[bytes]]
    read: Read


def file_reader(name: str, read: Callable[[Path], object]) -> Read:
    """Return the function that writes the input into a file and reads that."""

    def write_and_read(data: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(data)
        return read(path)

    return write_and_read


# ---- scenes, sensors, curves, tables


def _light(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.random.default_rng(1).random(shape, np.float32) + np.float32(0.01)


def _saved(name: str, save: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        save(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def _json_files(folder: str) -> list[bytes]:
    files = (resources.files("camctl.sim") / folder).iterdir()
    return [file.read_bytes() for file in files if file.name.endswith(".json")]


def _tiffs() -> list[bytes]:
    def write(light: np.ndarray, **options: Any) -> bytes:
        return _saved("a.tiff", lambda path: tifffile.imwrite(path, light, **options))

    return [
        write(_light(5, 6, 3), photometric="rgb"),
        write(_light(5, 6), compression="zlib", rowsperstrip=2),
        write((_light(20, 18) * 1000).astype(np.uint16), tile=(16, 16)),
        write(_light(3, 5, 6), photometric="rgb", planarconfig=2),
    ]


def _exrs() -> list[bytes]:
    def write(channels: dict[str, object], compression: int) -> bytes:
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        return _saved("a.exr", lambda path: OpenEXR.File(header, channels).write(str(path)))

    return [
        write({"RGB": _light(5, 6, 3)}, OpenEXR.ZIP_COMPRESSION),
        write({"Y": _light(5, 6).astype(np.float16)}, OpenEXR.NO_COMPRESSION),
        write({"RGB": _light(17, 33, 3).astype(np.float16)}, OpenEXR.PIZ_COMPRESSION),
    ]


def _rgbe() -> list[bytes]:
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n"
    run = b"\x02\x02\x00\x0a" + bytes((128 + 10, 200, 138, 100, 5, 1, 2, 3, 4, 5, 133, 9, 138, 129))
    flat = bytes(range(1, 6 * 4 + 1))
    return [head + b"-Y 3 +X 10\n" + run * 3, head + b"+Y 2 +X 6\n" + flat * 2]


def _load_sensor(path: Path) -> object:
    """Read a sensor, and take a frame with it: what is valid must work."""
    sensor = load_sensor(path)
    with SimulatedCamera(Scene("s", _light(4, 6), photons_per_unit=1e6), sensor) as camera:
        controls = camera.controls
        setting = camctl.ExposureSetting(controls.time_s.minimum, controls.gain.minimum)
        return camera.preview(setting).pixels.max()


def _load_drawn_scene(path: Path) -> object:
    return load_scene(path, (4, 6))


def _models() -> list[bytes]:
    number = np.linspace(0, 1, 9)

    def block(name: str, values: np.ndarray) -> str:
        return f"{name} =\n  " + "  ".join(f"{value:.6e}" for value in values) + "\n"

    text = (
        block("E", number) + block("f0", number**0.5) + block("h(1)", 0.1 * number * (1 - number))
    )
    return [(text + block("h(2)", 0.05 * number * (1 - number) ** 2)).encode()]


def _read_model(path: Path) -> object:
    return read_response_model(path).response((0.5, -0.3), bits=6)


def _tables() -> list[bytes]:
    jobs = table_jobs(linear_response(3), ("linear", "log"), (256.0, 1000.0), (1, 2))
    return [_saved("a.json", build_table(jobs).save)]


def _read_table(path: Path) -> object:
    """Read a table, and rate its exposures for the camera that they are for."""
    camera = linear_response(3)
    for entry in ExposureTable.load(path, camera).entries:
        if entry.camera == camera.fingerprint:
            evaluate(camera, desired_response("log", entry.dynamic_range), entry.exposures)
    return path


def _evaluate_desired(path: Path) -> object:
    """Read a desired response, and use it."""
    desired = read_desired(path)
    return evaluate(linear_response(4), desired, (1.0, 4.0)), desired.inverse([0.0, 0.5, 1.0])


def _read_settings(path: Path) -> object:
    return Settings("times", unit=Seconds(), file=True).parse(str(path), "--settings")


def _cached_job() -> Job:
    (job,) = table_jobs(linear_response(3), ("log",), (300.0,), (1,))
    return job


def _cached_rows() -> list[bytes]:
    return [solve_job(_cached_job()).model_dump_json().encode()]


def _look_up(data: bytes, folder: Path) -> object:
    """Look up a row of which the input is in the cache."""
    job = _cached_job()
    path = folder / "cache" / "exposure" / f"{job.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_CACHE", str(folder / "cache"))
        return look_up(job.response, job.desired, job.n)


def _profiles() -> list[bytes]:
    profile = Profile(
        driver="v4l2",
        make="Maker",
        model="Model",
        serial="1",
        delays={
            "mono8-640x480-30": DelayRecord(
                frames=2, smallest=2, largest=2, trials=12, measured_at="2026-01-01T00:00:00Z"
            )
        },
        stills={
            "raw": StillRecord(
                rows=24, columns=32, layout=Layout.RGGB, bits=12, black=64, white=4000
            )
        },
    )
    return [profile.model_dump_json(indent=2).encode()]


def _read_profiles(data: bytes, folder: Path) -> object:
    (folder / "profiles").mkdir(exist_ok=True)
    (folder / "profiles" / "a.json").write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(folder / "profiles"))
        return list_profiles()


def _npys() -> list[bytes]:
    def save(array: np.ndarray) -> bytes:
        return _saved("a.npy", lambda path: np.save(path, array))

    return [save(_light(5, 6, 3)), save((_light(4, 3) * 255).astype(np.uint8))]


CURVE = b"# irradiance brightness\n0 0\n0.1 0.31\n0.25,0.5\n0.5;0.71\n1\t1\n"
SETTINGS = b"# seconds\n1/1000\n0.004\n1/32\n\n0.5 # long\n1\n"
DEVICES = b'{"devices": [{"name": "cam0", "kind": "uvc"}, {"name": "s", "kind": "sierra"}]}'
SOLVER_ROWS = (
    b'[{"method": "camctl", "response": "log", "dynamic_range": 1000.0, "n": 3, "bits": 8, '
    b'"seed": 0, "limit_s": 2.0, "max_evaluations": null, "xi": 12.5}]'
)
SIMULATION_ROWS = (
    b'{"format_version": 1, "rows": [{"scene": "room", '
    b'"sensor": "complete", "tolerances_dn": [0, 0.5], "stops": 0.0, '
    b'"size": "64x48", "seed": 0, "frames": 5}]}'
)


def _always(*samples: bytes) -> Callable[[], list[bytes]]:
    return lambda: list(samples)


FILES = {
    "sensor": Reader(lambda: _json_files("sensors"), file_reader("a.json", _load_sensor)),
    "scene file": Reader(lambda: _json_files("scenes"), file_reader("a.json", _load_drawn_scene)),
    "scene hdr": Reader(_rgbe, file_reader("a.hdr", load_scene)),
    "scene exr": Reader(_exrs, file_reader("a.exr", load_scene)),
    "scene tiff": Reader(_tiffs, file_reader("a.tiff", load_scene)),
    "scene npy": Reader(_npys, file_reader("a.npy", load_scene)),
    "curve": Reader(_always(CURVE), file_reader("a.txt", lambda path: read_curve(path, bits=6))),
    "desired": Reader(
        _always(CURVE.replace(b"0 0\n", b"")), file_reader("a.txt", _evaluate_desired)
    ),
    "response model": Reader(_models, file_reader("a.txt", _read_model)),
    "settings": Reader(_always(SETTINGS), file_reader("a.txt", _read_settings)),
    "table": Reader(_tables, file_reader("a.json", _read_table)),
    "cached row": Reader(_cached_rows, _look_up),
    "profile": Reader(_profiles, _read_profiles),
    "solver rows": Reader(
        _always(SOLVER_ROWS), file_reader("a.json", lambda path: read_runs(path, SolverRun))
    ),
    "simulation rows": Reader(
        _always(SIMULATION_ROWS), file_reader("a.json", lambda path: read_runs(path, SimulationRun))
    ),
    "virtual devices": Reader(_always(DEVICES), file_reader("a.json", read_config)),
}
