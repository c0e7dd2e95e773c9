"""A camera body through libgphoto2: its dials with true values, and its settings put to manual."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel, TypeAdapter

from camctl.drivers.gphoto2 import labels
from camctl.drivers.gphoto2.process import CameraProcess
from camctl.errors import CameraError, CameraProtocolError, RefusedSettingError
from camctl.interface.controls import Choices, ExposureSetting

#: How long a busy camera is asked again to take a setting, s.
_BUSY_S = 20.0
#: Names of the setting for each dial, the preferred first: Nikon's shutterspeed2 has fractions
#: where shutterspeed has multiples of 0.1 ms.
_TIMES = ("shutterspeed2", "shutterspeed", "exptime")
_GAINS = ("iso", "isospeed")
_F_NUMBERS = ("aperture", "f-number")
#: Settings that would change the exposure: names, and the choices that are manual.
_MANUAL: Mapping[str, tuple[str, ...]] = {
    "expprogram": ("m", "manual"),
    "autoexposuremode": ("manual", "m"),
    "autoexposuremodedial": ("manual", "m"),
    "exposuremode": ("m", "manual"),
    "isoauto": ("off",),
}
_TO_MANUAL = "turn the mode dial to M, or switch that off on the camera"
#: Below this charge a camera that takes no picture probably lacks power, per cent.
_LOW_BATTERY_PERCENT = 5
_TARGETS: Mapping[str, tuple[str, ...]] = {
    "ram": ("internal ram", "sdram"),
    "card": ("memory card", "card"),
}
_QUALITIES = ("imageformat", "imagequality")
_RAW_WORDS = ("raw", "nef", "cr2", "cr3", "arw", "raf", "orf", "rw2", "pef", "dng")


class Widget(BaseModel):
    """A setting as libgphoto2 reports it."""

    label: str
    kind: str
    value: str
    choices: list[str]
    is_read_only: bool


_WIDGETS = TypeAdapter(dict[str, Widget])


@dataclass(frozen=True)
class Dial:
    """A setting of the exposure: its name, and the label of each true value."""

    name: str
    labels: Mapping[float, str]

    @property
    def control(self) -> Choices:
        return Choices(tuple(self.labels))

    def value_of(self, label: str) -> float | None:
        """Return the true value of a label that the camera has; None for Auto, Bulb and others."""
        return next((value for value, each in self.labels.items() if each == label), None)


class Body:
    """A connected body, set to manual.

    Args:
        process: connected to the camera
        target: "ram" or "card": where pictures are stored; "auto": ram where the camera has it

    Attributes:
        make, model, serial: as the camera reports
        time_s, gain, f_number: its dials; None where it has none that can be set
        notes: what a person should know of them

    Raises:
        CameraError: it has no shutter time that can be set, or does not leave its automatic mode
    """

    def __init__(self, process: CameraProcess, target: str = "auto") -> None:
        self._process = process
        self.notes: list[str] = []
        self._widgets = self._read()
        self.make, self.model, self.serial = (
            self._text(name) for name in ("manufacturer", "cameramodel", "serialnumber")
        )
        for name, wanted in _MANUAL.items():
            self._set_manual(name, wanted)
        self.target = self._set_target(target)
        self._widgets = self._read()  # other modes have other choices
        time_s = self._dial(_TIMES, labels.seconds)
        if time_s is None:
            raise CameraError(
                f"{process.name} has no shutter time that libgphoto2 can set",
                hint="turn the mode dial to M and leave movie and playback mode; if it is at M, "
                "its model cannot be controlled",
            )
        self.time_s = time_s
        self.gain = self._dial(_GAINS, labels.gain)
        self.f_number = self._dial(_F_NUMBERS, labels.f_number, power=2)

    @property
    def makes_raw(self) -> bool:
        """Whether the camera is set to save raw files."""
        words = " ".join(self._text(name).lower() for name in _QUALITIES)
        return any(word in words for word in _RAW_WORDS)

    def why_no_picture(self, *, is_silent: bool) -> tuple[str, str] | None:
        """Return what its settings show of why it takes no picture, and what to do; None: nothing.

        Of a silent camera the last settings count that are known, and only its battery.  libgphoto2
        gives no reason where a Sony or a Nikon does not focus, or its mode dial was turned.
        """
        with suppress(CameraError):
            self._widgets = self._read()
        charge = re.fullmatch(r"(\d+)\s*%", self._text("batterylevel"))
        if charge and int(charge[1]) <= _LOW_BATTERY_PERCENT:
            return (
                f"its battery has {charge[1]} % of its charge",
                "charge it or use a mains adapter",
            )
        if is_silent:
            return None
        for name, wanted in _MANUAL.items():
            widget = self._widgets.get(name)
            if widget is not None and self._is_automatic(widget, wanted):
                return f"it is in mode {widget.value} ({widget.label.lower()})", _TO_MANUAL
        focus = self._text("focusmode")
        if re.search(r"auto|AF|servo|shot", focus, re.IGNORECASE) and "MF" not in focus:
            return (
                f"its autofocus is on ({focus}), and without focus it takes no picture",
                "set the lens or the camera to manual focus (MF), and take the lens cap off",
            )
        return None

    def apply(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the dials; return the setting as the camera has it then.

        Raises:
            RefusedSettingError: the camera has another value then
        """
        requested = {
            name: (dial, value)
            for name, dial, value in (
                ("time_s", self.time_s, setting.time_s),
                ("gain", self.gain, setting.gain),
                ("f_number", self.f_number, setting.f_number),
            )
            if dial is not None and value is not None
        }
        labels = {
            dial.name: dial.labels[dial.control.nearest(value)]
            for dial, value in requested.values()
        }
        found = self._process.ask("apply", values=labels, busy_s=_BUSY_S)
        applied: dict[str, float] = {}
        for name, (dial, value) in requested.items():
            label = found[dial.name]
            true = dial.value_of(label)
            if true is None:
                raise CameraProtocolError(
                    f"{self._process.name} changed its {name} to '{label}'",
                    hint="turn the mode dial to M and leave the dials alone",
                )
            if label != labels[dial.name]:
                raise RefusedSettingError(name, value, true)
            applied[name] = true
        return replace(setting, **applied)

    def _read(self) -> dict[str, Widget]:
        found: Any = self._process.ask("widgets", busy_s=_BUSY_S)
        return _WIDGETS.validate_python(found)

    def _text(self, name: str) -> str:
        widget = self._widgets.get(name)
        return widget.value.strip() if widget is not None else ""

    def _dial(self, names: tuple[str, ...], parse: labels.Parse, power: int = 1) -> Dial | None:
        for name in names:
            widget = self._widgets.get(name)
            if widget is None or widget.is_read_only:
                continue
            found = labels.true_values(widget.choices, parse, self.make, power)
            if found:
                return Dial(name, found)
        return None

    def _set_manual(self, name: str, wanted: tuple[str, ...]) -> None:
        widget = self._widgets.get(name)
        if widget is None or not self._is_automatic(widget, wanted):
            return
        if not widget.is_read_only:
            manual = next(each for each in widget.choices if each.strip().lower() in wanted)
            applied = self._process.ask("apply", values={name: manual}, busy_s=_BUSY_S)
            if applied[name] == manual:
                return
        raise CameraError(
            f"{self._process.name} is in mode {widget.value} ({widget.label.lower()})",
            hint=_TO_MANUAL,
        )

    @staticmethod
    def _is_automatic(widget: Widget, wanted: tuple[str, ...]) -> bool:
        """Whether a setting is not manual; one without a manual choice is another of that name."""
        choices = [each.strip().lower() for each in widget.choices]
        can_be = widget.is_read_only or any(each in wanted for each in choices)
        return can_be and widget.value.strip().lower() not in wanted

    def _set_target(self, target: str) -> str:
        """Let the camera store its pictures in a place; return "ram", "card", or "" if unknown."""
        widget = self._widgets.get("capturetarget")
        if widget is None:
            return ""
        for name in ("ram", "card") if target == "auto" else (target,):
            for choice in widget.choices:
                if choice.strip().lower() in _TARGETS[name]:
                    applied = self._process.ask(
                        "apply", values={"capturetarget": choice}, busy_s=_BUSY_S
                    )
                    if applied["capturetarget"] == choice:
                        return name
        self.notes.append(f"pictures are stored in '{widget.value}', which could not be changed")
        return ""
