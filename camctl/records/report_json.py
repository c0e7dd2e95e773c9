"""The layout of ``report.json`` and ``--json``: a report without what follows from its fields.

What is null, empty or has its default is left out, and so is what `FOLLOWS` names; `from_json` puts
the latter back.
"""

from __future__ import annotations

from typing import Any, Final

from camctl.exposure.search.settings import relative_exposures
from camctl.interface.controls import ExposureSetting
from camctl.records.report import CaptureReport, UnfinishedCapture

Json = dict[str, Any]

FOLLOWS: Final[dict[str, str]] = {
    "achieved.noise": '"plan.noise" where it is the noise of the plan',
    "movement.places": "left out where there are none",
    "simulation.left_out": "left out where there are none",
    "frames[].requested": "left out: it is the setting in `plan.settings`",
    "frames[].applied": "left out: its time is `applied_s`; `gain` and `f_number` stand beside it",
    "frames[].exposure_ratio": "left out where the camera's statement is all that is known",
    "frames[].exposure_ratio.exposure": "left out: it is `frames[].exposure`",
    "plan.exposures": "left out: they follow from `plan.settings`",
    "plan.shutter_s": "left out: the sum of the times in `plan.settings`",
    "white": "left out of a complete capture: it is `frames[].white`",
    "versions": 'one text, such as "camctl 0.2.0, numpy 2.3.1, python 3.11.7"',
}
"""Fields of a report that its JSON has in another form, or not at all, and where they are then."""

#: Fields that `to_json` leaves out, by the model in the schema; "" is the report.
_NOT_REQUIRED: Final[dict[str, set[str]]] = {
    "": {"white"},
    "CapturePlan": {"exposures", "shutter_s"},
    "FrameRecord": {"requested", "applied"},
    "ExposureRatio": {"exposure"},
    "FoundMovement": {"places"},
    "SimulationSummary": {"left_out"},
}
#: What scripts may look for, whatever its value is.
_ALWAYS = {"format_version", "status", "trustworthy", "findings", "warnings"}
_PLAN_NOISE = "plan.noise"
_EMPTY: Final[dict[str, tuple[str, Any]]] = {
    "movement": ("places", []),
    "simulation": ("left_out", {}),
}


def to_json(report: CaptureReport | UnfinishedCapture) -> Json:
    """Return a report as it is written."""
    content: Json = report.model_dump(mode="json", exclude_defaults=True)
    content |= report.model_dump(mode="json", include=_ALWAYS)
    plan = content["plan"]
    plan |= {"noise": plan.get("noise"), "objective": report.plan.objective}
    _leave_out(plan, _from_settings(plan["settings"]))
    content["versions"] = ", ".join(f"{name} {text}" for name, text in report.versions.items())
    for frame, setting in zip(content["frames"], plan["settings"], strict=True):
        if frame is not None:
            _shorten_frame(frame, setting)
    if isinstance(report, CaptureReport):
        for name, (part, empty) in _EMPTY.items():
            _leave_out(content.get(name, {}), {part: empty})
        _leave_out(content, {"white": content["frames"][0]["white"]})
        achieved = content["achieved"]
        if achieved.setdefault("noise", None) == plan["noise"] is not None:
            achieved["noise"] = _PLAN_NOISE
    return content


def report_schema() -> Json:
    """Return the JSON schema of what `to_json` returns for a complete capture."""
    schema = CaptureReport.model_json_schema(mode="serialization")
    parts = {"": schema, **schema["$defs"]}
    for name, fields in _NOT_REQUIRED.items():
        part = parts[name]
        part["required"] = [each for each in part.get("required", ()) if each not in fields]
    schema["properties"]["versions"] = {"type": "string"}
    noise = parts["Achieved"]["properties"]["noise"]
    noise["anyOf"] = [*noise["anyOf"], {"const": _PLAN_NOISE}]
    settings = parts["ExposureSetting"]["properties"]
    frame = parts["FrameRecord"]["properties"]
    frame |= {name: kind for name, kind in settings.items() if name != "time_s"}
    return schema


def _shorten_frame(frame: Json, setting: Json) -> None:
    applied = frame.pop("applied")
    frame |= {name: value for name, value in applied.items() if name != "time_s"}
    _leave_out(frame, {"requested": setting})
    if (ratio := frame.get("exposure_ratio")) is not None:
        _leave_out(ratio, {"exposure": frame["exposure"]})
        _leave_out(frame, {"exposure_ratio": _label_alone(frame)})


def _leave_out(content: Json, known: Json) -> None:
    """Remove fields that have the values that are known without them."""
    for name, value in known.items():
        if name in content and content[name] == value:
            del content[name]


def _from_settings(settings: list[Json]) -> Json:
    """Return the fields of a plan that follow from its settings."""
    made = [ExposureSetting(**setting) for setting in settings]
    return {
        "exposures": list(relative_exposures(made)),
        "shutter_s": sum(setting.time_s for setting in made),
    }


def _label_alone(frame: Json) -> Json:
    """Return where the exposure of a frame comes from if only the camera states it."""
    return {"used": "label", "label": frame["exposure"]}


def from_json(content: Any) -> Any:
    """Return what `to_json` has written with what it left out; what is no report stays as it is."""
    try:
        return _completed(content)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return content  # the models say what is wrong with it


def _completed(content: Json) -> Json:
    plan, frames = dict(content["plan"]), []
    for position, frame in enumerate(content["frames"]):
        frames.append(
            None if frame is None else _completed_frame(frame, plan["settings"][position])
        )
    plan = {**_from_settings(plan["settings"]), **plan}
    found = {**content, "plan": plan, "frames": frames}
    found["versions"] = dict(part.split(" ", 1) for part in content["versions"].split(", "))
    if "achieved" in content:
        found.setdefault("white", content["frames"][0]["white"])
        for name, (part, empty) in _EMPTY.items():
            if content.get(name):
                found[name] = {part: empty, **content[name]}
        if content["achieved"].get("noise") == _PLAN_NOISE:
            found["achieved"] = {**content["achieved"], "noise": plan["noise"]}
    return found


def _completed_frame(frame: Json, setting: Json) -> Json:
    found = {"requested": setting, **frame}
    if "applied" not in frame:
        applied = {name: found.pop(name) for name in ("gain", "f_number") if name in found}
        found["applied"] = {"time_s": frame["applied_s"], **applied}
    if "exposure" in frame:
        ratio = frame.get("exposure_ratio") or _label_alone(frame)
        found["exposure_ratio"] = {"exposure": frame["exposure"], **ratio}
    return found
