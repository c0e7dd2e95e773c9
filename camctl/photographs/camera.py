"""What photographs state of their exposures, and the camera whose frames they are.

The plan of a capture chooses among the photographs as it chooses among the settings of any camera,
and the frames are summed, checked and rendered by the same code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from camctl.findings import Detail, Finding
from camctl.interface.camera import CameraBase, CameraInfo, Frame, Pixels
from camctl.interface.clock import RealClock
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.interface.layout import BRIGHTNESS_STEPS

#: Id and driver of this camera.
_ID = "photographs"
#: Photographs of the same exposure are distinguished by this relative difference.
_APART = 1e-7
#: Stated times that are labels of a dial agree with one of these to this relative difference.
_SAME_LABEL = 0.015
#: Labels of dials in thirds and halves of a stop, s and 1/s.
_LABELS = (
    *(1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 45, 50, 60, 80, 90),
    *(100, 125, 160, 180, 200, 250, 320, 350, 400, 500, 640, 750, 800, 1000, 1250, 1500, 1600),
    *(2000, 2500, 3000, 3200, 4000, 5000, 6000, 6400, 8000, 10000, 12800, 16000, 32000),
)
_TENTHS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
_LONGEST_LABEL_S = 60.0


@dataclass(frozen=True)
class Photograph:
    """One photograph, as its file or its user states it.

    Attributes:
        name: of its file, as one visible line
        time_s: shutter time, s
        gain: linear gain, 1 for ISO 100
        f_number: f-number; None where it is not stated
        taken_at: when it was taken; None where that is not stated
        iso: ISO speed as stated; None where it is not
        flash_fired: whether the flash did; None where it is not stated
        file_details: as `Still` has them
    """

    name: str
    time_s: float
    gain: float = 1.0
    f_number: float | None = None
    taken_at: datetime | None = None
    iso: float | None = None
    flash_fired: bool | None = None
    file_details: Mapping[str, Any] = field(default_factory=dict)

    def without_blocks(self) -> Photograph:
        """Return it as it is where the blocks of its file are not in their places."""
        details = dict(self.file_details)
        details.pop(BRIGHTNESS_STEPS, None)
        return replace(self, file_details=details)

    @property
    def setting(self) -> ExposureSetting:
        """Time, gain and f-number."""
        return ExposureSetting(self.time_s, self.gain, self.f_number)

    @property
    def exposure(self) -> float:
        """Exposure, which is time x gain / f-number^2, in arbitrary but constant units."""
        return self.setting.exposure


def is_dial_label(time_s: float) -> bool:
    """Return whether a stated time is a label of a dial, such as 1/60, 1/15 or 30.

    >>> is_dial_label(1 / 60), is_dial_label(1 / 47)
    (True, False)
    """
    if not 0 < time_s <= _LONGEST_LABEL_S:
        return False
    labels = (*_LABELS, *_TENTHS) if time_s >= 0.3 else _LABELS
    value = time_s if time_s >= 0.3 else 1 / time_s
    return any(math.isclose(value, label, rel_tol=_SAME_LABEL) for label in labels)


def true_time_s(label_s: float) -> float:
    """Return the true time of a dial's label: a power of two in thirds or halves of a stop.

    Debevec and Malik (1997), section 2.1, measured it so.

    >>> 1 / true_time_s(1 / 60), true_time_s(30), round(true_time_s(1 / 90) * 90.5, 3)
    (64.0, 32.0, 1.0)
    """
    stops = math.log2(label_s)
    thirds, halves = round(3 * stops) / 3, round(2 * stops) / 2
    return math.exp2(halves if abs(stops - halves) < abs(stops - thirds) / 3 else thirds)


def true_f_number(label: float) -> float:
    """Return the true f-number of a label: a power of two in sixths.

    >>> round(true_f_number(5.6), 3), round(true_f_number(11), 3), true_f_number(8)
    (5.657, 11.314, 8.0)
    """
    return math.exp2(round(6 * math.log2(label)) / 6)


def with_true_exposures(photographs: Sequence[Photograph]) -> list[Photograph] | None:
    """Return photographs with the true times and f-numbers of their labels.

    None: not all times are labels, so that they are taken as they are.
    """
    if not all(is_dial_label(each.time_s) for each in photographs):
        return None
    return [
        replace(
            each,
            time_s=true_time_s(each.time_s),
            f_number=None if each.f_number is None else true_f_number(each.f_number),
        )
        for each in photographs
    ]


def with_all_stated(
    photographs: Sequence[Photograph],
) -> tuple[list[Photograph], list[Finding]]:
    """Return photographs with what some do not state of their exposures, and others do.

    It is the value of the others if all of them have the same, else ISO 100 and f/1.  The second
    result has a finding for each, about the photographs that state nothing.
    """
    found, notes = list(photographs), []
    for what, attribute, default in (("ISO", "iso", 100.0), ("f-number", "f_number", 1.0)):
        values = [getattr(each, attribute) for each in found]
        silent = tuple(k for k, value in enumerate(values) if not value)
        stated = set(filter(None, values))
        if not silent or not stated:
            continue
        value = stated.pop() if len(stated) == 1 else default
        changes: dict[str, Any] = {attribute: value}
        if attribute == "iso":
            changes["gain"] = value / 100
        for k in silent:
            found[k] = replace(found[k], **changes)
        finding = Finding(code="tags_differ", frames=silent, value=value)
        notes.append(detailed(finding, what=what))
    return found, notes


def flashes(photographs: Sequence[Photograph]) -> list[Finding]:
    """Return a finding where the flash fired in some photographs, and not in others."""
    fired, dark = (
        [k for k, each in enumerate(photographs) if each.flash_fired is is_fired]
        for is_fired in (True, False)
    )
    if not fired or not dark:
        return []
    odd = fired if len(fired) <= len(dark) else dark
    is_fired = odd is fired
    return [Finding(code="light_differs", frames=tuple(odd), details={"flash_fired": is_fired})]


def named(finding: Finding, photographs: Sequence[Photograph]) -> Finding:
    """Return a finding with the names of its photographs, which are at its frames' positions."""
    names = [photographs[k].name for k in finding.frames]
    details: dict[str, Detail] = dict(zip(("file", "other"), names, strict=False))
    details |= {"files": ", ".join(names), "count": len(names)}
    return detailed(finding, **(details | finding.details))


def detailed(finding: Finding, **details: Detail) -> Finding:
    """Return a finding with more details."""
    return finding.model_copy(update={"details": finding.details | details})


def at(finding: Finding, positions: Sequence[int]) -> Finding:
    """Return a finding about places of a list of positions as one about these positions."""
    return finding.model_copy(update={"frames": tuple(positions[k] for k in finding.frames)})


class PhotographCamera(CameraBase):
    """A camera whose only settings are the exposures of photographs, and whose frames are these.

    A setting's time stands for the whole exposure: the shutter time that has it at the sensitivity
    and aperture of the first photograph.  The applied setting of a frame is the photograph's own.

    Args:
        photographs: in any order, two or more
        load: returns the pixels of a photograph by its position
        controls: what is known of the frames; `time_s` is not used
        taken_by: make, model and serial number of the camera that took them, for the report
        metered: returns likewise the pixels by which the light is metered; None: as `load`

    Attributes:
        photographs: as given
        times_s: time of the setting of each photograph, s
    """

    def __init__(
        self,
        photographs: Sequence[Photograph],
        load: Callable[[int], Pixels],
        controls: ExposureControls,
        taken_by: tuple[str, str, str] = ("", "", ""),
        metered: Callable[[int], Pixels] | None = None,
    ) -> None:
        super().__init__("the set of photographs", RealClock())
        self.photographs = tuple(photographs)
        self._load, self._given, self._taken_by = load, controls, taken_by
        self._metered = metered or load
        unit = photographs[0].exposure / photographs[0].time_s
        times: list[float] = []
        order = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
        for position in order:
            time_s = photographs[position].exposure / unit
            times.append(max(time_s, times[-1] * (1 + _APART)) if times else time_s)
        self._position = dict(zip(times, order, strict=True))
        self.times_s = [time_s for _, time_s in sorted(zip(order, times, strict=True))]
        self.open()

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return the photograph at `setting`, for metering."""
        self._check_ready()
        self.controls.check(setting)
        return self._frame(setting, 0, self._metered)

    def chosen(self, settings: Sequence[ExposureSetting]) -> list[int]:
        """Return the positions of the photographs at `settings`."""
        return [self._position[self.controls.time_s.nearest(each.time_s)] for each in settings]

    def _open(self) -> None:
        make, model, serial = self._taken_by
        self._info = CameraInfo(_ID, make, model or _ID, serial, _ID)
        times = Choices(tuple(sorted(self._position)))
        self._controls = replace(
            self._given,
            time_s=times,
            gain=Choices((1.0,)),
            tolerance=1e-9,
            exposures_exact=False,  # shutters are not, and labels may be wrong
            repeatable=False,
        )

    def _close(self) -> None:
        """There is nothing to disconnect."""

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        for index, setting in enumerate(settings):
            yield self._frame(setting, index, self._load)

    def _frame(self, setting: ExposureSetting, index: int, load: Callable[[int], Pixels]) -> Frame:
        (position,) = self.chosen([setting])
        controls, photograph = self.controls, self.photographs[position]
        details: dict[str, Any] = {"file": photograph.name, **photograph.file_details}
        if photograph.iso is not None:
            details["iso"] = photograph.iso
        if photograph.taken_at is not None:
            details["taken_at"] = photograph.taken_at.isoformat()
        return Frame(
            load(position),
            setting,
            photograph.setting,
            self.clock.now(),
            index,
            controls.black,
            controls.white,
            details=details,
        )
