"""The types of what each command prints with ``--json``; their schemas are made from them.

Only `camctl schema` and tests import this module: commands print what they have.
"""

from __future__ import annotations

from typing import (
    Any,
    Final,
    Literal,
    NotRequired,  # pydantic takes no other before 3.12
)

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict, is_typeddict

from camctl.calibration.results import (
    ColourResult,
    DelayResult,
    ExposureResult,
    NoiseResult,
    ResponseResult,
    StepsResult,
    StillTiming,
)
from camctl.cli.doctor.checks import Diagnosis
from camctl.exposure.table import TableEntry
from camctl.findings import Finding
from camctl.interface.camera import CameraInfo
from camctl.model.noise import NoiseModel
from camctl.profiles.profile import Profile
from camctl.records.journal import SeriesJournal
from camctl.records.report_json import report_schema
from camctl.sim.render import Comparison
from camctl.studies.capture_study import CapturePoint, CaptureRun
from camctl.studies.simulation_study import SimulationPoint, SimulationRun
from camctl.studies.solver_study import SolverPoint, SolverRun

Version = Literal[1]


class _Error(TypedDict):
    """Why a command could not be done."""

    type: str
    message: str
    hint: str | None


class Failure(TypedDict):
    """What any command prints where it fails."""

    format_version: Version
    error: _Error


class _Levels(TypedDict):
    effective_levels: float
    effective_levels_noise_free: float


class Unrestricted(_Levels):
    """The best exposures of any times, beside those that a camera has."""

    exposures: tuple[float, ...]
    xi: float


class Certificate(TypedDict):
    """How much better other exposures can be at most."""

    proven: bool
    best_known_xi: float
    lower_bound: float
    relative_gap: float
    evaluations: int
    seconds: float


class _Rated(_Levels):
    """Exposures for a desired response of a camera, and how good they are."""

    format_version: Version
    exposures: tuple[float, ...]
    xi: float
    levels_wanted: float
    total_exposure: float
    noise: NoiseModel | None
    response: str
    dynamic_range: float
    camera: str


class Solved(_Rated):
    """The best exposures: `camctl solve`."""

    seconds: float
    evaluations: int
    objective: Literal["xi", "accuracy"]
    seed: int
    certificate: NotRequired[Certificate]
    times_s: NotRequired[tuple[float, ...]]
    gains: NotRequired[tuple[float, ...]]
    shutter_s: NotRequired[float]
    exhaustive: NotRequired[bool]
    unrestricted: NotRequired[Unrestricted]


class Spread(TypedDict):
    """Quality under a disturbance: on average, and in the worst case."""

    xi: float
    xi_worst: float
    effective_levels: float
    effective_levels_worst: float


class WithNoise(TypedDict):
    """Effective levels with noise, and those of as many equal exposures."""

    effective_levels: float
    effective_levels_equal_exposures: float


class Sensitivity(TypedDict):
    """Quality with disturbances, by their size."""

    exposure_error: dict[str, Spread]
    noise: dict[str, WithNoise]
    phase: Spread


class Evaluated(_Rated):
    """How good given exposures are: `camctl evaluate`."""

    levels: int
    levels_distinct: int
    effective_levels_equal_exposures: NotRequired[float]
    sensitivity: NotRequired[Sensitivity]


class ShownEntry(TypedDict):
    """A row of the exposure table: see `TableEntry`, whose fields it has."""

    response: str
    dynamic_range: float
    n: int
    camera: str
    camera_name: str
    levels_wanted: float
    exposures: tuple[float, ...]
    xi: float
    effective_levels: float
    effective_levels_noise_free: float
    total_exposure: float
    chosen_by: Literal["xi", "accuracy"]
    sensitivity: NotRequired[Sensitivity]


class ShownTable(TypedDict):
    """Rows of an exposure table, with the noise of a camera: `camctl table show`."""

    format_version: Version
    entries: list[ShownEntry]
    noise: NoiseModel | None


class BuiltTable(TypedDict):
    """A new exposure table: `camctl table build`."""

    format_version: Version
    file: str
    entries: list[TableEntry]


class PreviewedResponse(TypedDict):
    """The scene in one response."""

    response: str
    dynamic_range: float
    planned_times_s: list[float]
    effective_levels: float
    dark_fraction: float
    saturated_fraction: float


class Previewed(TypedDict):
    """What the camera sees: `camctl preview`."""

    format_version: Version
    file: str
    findings: list[Finding]
    warnings: list[str]
    dynamic_range: float
    preview_times_s: list[float]
    left_out_s: list[float]
    unseen_fraction: float
    planned_times_s: list[float]
    responses: list[PreviewedResponse]


class Streamed(TypedDict):
    """A stream that has ended: `camctl live`."""

    format_version: Version
    results: int
    seconds: float
    results_per_second: float
    lost: int
    latency_s: float | None
    age_s: float | None
    exposures_s: list[float]
    dynamic_range: float | None
    findings: list[Finding]


class Effect(TypedDict):
    """One effect of the simulated sensor; a bound without limit is null."""

    name: str
    bound_dn: float | None
    own_dn: float | None
    ran: bool
    why: str
    milliseconds: float


class _Bounds(TypedDict):
    tolerance_dn: float
    joint_bound_dn: float | None
    effects: list[Effect]


class SimulatedFrame(_Bounds):
    """A simulated frame, and which effects it has."""

    time_s: float
    gain: float
    width: int
    height: int
    layout: str
    black: int
    white: int
    minimum: int
    mean: float
    maximum: int
    saturated_fraction: float
    file: str | None
    compared_with_every_effect: NotRequired[Comparison]


class Simulated(SimulatedFrame):
    """One simulated frame: `camctl simulate`."""

    format_version: Version
    seconds: float


class SimulatedBracket(_Bounds):
    """Several simulated frames: `camctl simulate --bracket`."""

    format_version: Version
    seconds: float
    frames: list[SimulatedFrame]


class Named(TypedDict):
    """A profile that was imported: `camctl profile import`."""

    format_version: Version
    name: str
    file: str


class Removed(TypedDict):
    """The file of a profile that was removed: `camctl profile remove`."""

    format_version: Version
    removed: str


class Cameras(TypedDict):
    """The connected cameras: `camctl cameras`."""

    format_version: Version
    cameras: list[CameraInfo]


class Profiles(TypedDict):
    """All profiles: `camctl profile list`."""

    format_version: Version
    profiles: list[Profile]


class Figure(TypedDict):
    """A figure of the paper."""

    figure: str
    title: str
    caption: str
    files: list[str]


class Figures(TypedDict):
    """Figures that were drawn: `camctl figures`."""

    format_version: Version
    figures: list[Figure]


TYPES: Final[dict[str, Any]] = {
    "calibrate all": StepsResult,
    "calibrate colour": ColourResult,
    "calibrate delay": DelayResult | StillTiming,
    "calibrate exposure": ExposureResult,
    "calibrate noise": NoiseResult,
    "calibrate response": ResponseResult,
    "cameras": Cameras,
    "doctor": Diagnosis,
    "error": Failure,
    "evaluate": Evaluated,
    "figures": Figures,
    "live": Streamed,
    "preview": Previewed,
    "profile import": Named,
    "profile list": Profiles,
    "profile remove": Removed,
    "profile show": Profile,
    "series": SeriesJournal,
    "simulate": Simulated | SimulatedBracket,
    "solve": Solved,
    "table build": BuiltTable,
    "table show": ShownTable,
}
"""What each command prints; "error" is what any of them prints where it fails."""

BESIDE: Final[dict[str, dict[str, Any]]] = {
    "merge": {"photographs": list[dict[str, Any]], "response_from": str, "facts": list[Any]},
    "profile list": {"name": str},
    "profile show": {"format_version": Version, "name": str},
    "series": {"completed": int, "failed": int},
}
"""Fields that the output of a command has beside those of its model."""

ROWS: Final[dict[str, tuple[type, type, dict[str, Any]]]] = {
    "tradeoff capture": (
        CaptureRun,
        CapturePoint,
        {
            "times_s": list[float],
            "gains": list[float],
            "effective_levels_measured": float | None,
            "less_accurate_by": float | None,
            "spread": list[float] | None,
            "slower_by": float | None,
        },
    ),
    "tradeoff simulation": (SimulationRun, SimulationPoint, {}),
    "tradeoff solver": (SolverRun, SolverPoint, {"regret": float}),
}
"""Studies that print rows: what each needs to be run again, its results, and further fields."""

REPORTS: Final = ("shoot", "resume", "merge")
"""Commands that print a report, of which ``report.json`` leaves out what follows from the rest."""


def _rows(run: type, point: type, more: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of rows; a number that is not known is null."""
    parts = [TypeAdapter(kind).json_schema(mode="serialization") for kind in (run, point)]
    properties = parts[0]["properties"] | parts[1]["properties"]
    properties |= {name: TypeAdapter(kind).json_schema() for name, kind in more.items()}
    parts_of_rows = {name: kind for part in parts for name, kind in part.get("$defs", {}).items()}
    for fields in (properties, *(each.get("properties", {}) for each in parts_of_rows.values())):
        for name, kind in fields.items():
            if kind.get("type") == "number":
                fields[name] = {**kind, "type": ["number", "null"], "default": None}
    row = {"type": "object", "properties": properties, "additionalProperties": False}
    return {
        "$defs": parts_of_rows,
        "type": "object",
        "properties": {
            "format_version": TypeAdapter(Version).json_schema(),
            "rows": {"type": "array", "items": row},
        },
        "required": ["format_version", "rows"],
        "additionalProperties": False,
    }


def _either(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of one of two; models that both have may lack what the first leaves out."""
    models = second.pop("$defs") | first.pop("$defs")
    return {"$defs": models, "anyOf": [first, second]}


def schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of what a command prints."""
    if name == "resume":
        found = _either(report_schema(), schema("series"))
    elif name in REPORTS:
        found = report_schema()
    elif name in ROWS:
        found = _rows(*ROWS[name])
    else:
        kind = TYPES[name]
        if is_typeddict(kind):
            kind.__pydantic_config__ = ConfigDict(extra="forbid")
        found = TypeAdapter(kind).json_schema(mode="serialization")
    of_object = found["$defs"]["Profile"] if name == "profile list" else found
    for field, kind in BESIDE.get(name, {}).items():
        of_object["properties"][field] = TypeAdapter(kind).json_schema()
        of_object["required"].append(field)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"camctl {name} --json",
        **{key: value for key, value in found.items() if key != "title"},
    }


def schema_names() -> list[str]:
    """Return the names of all schemas."""
    return sorted({*TYPES, *REPORTS, *ROWS})
