"""Photographs already taken, as a camera that has only their settings.

The plan of a capture then chooses among the photographs as it chooses among the settings of any
camera, and the frames are summed, checked and rendered by the same code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from camctl.interface.camera import CameraBase, CameraInfo, Frame, Pixels
from camctl.interface.clock import RealClock
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.photographs.photograph import Photograph

#: Id and driver of this camera.
_ID = "photographs"
#: Photographs of the same exposure are distinguished by this relative difference.
_APART = 1e-7


class PhotographCamera(CameraBase):
    """A camera whose only settings are the exposures of photographs, and their frames its frames.

    A setting's time stands for the whole exposure: the shutter time that has it at the sensitivity
    and aperture of the first photograph.  The applied setting of a frame is the photograph's own.

    Args:
        photographs: in any order, two or more
        load: returns the pixels of a photograph by its position
        controls: what is known of the frames; `time_s` is not used
        taken_by: make, model and serial number of the camera that took them, for the report
        metered: returns likewise the pixels by which the light is metered; None: those of `load`

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
        details: dict[str, str | float] = {"file": photograph.name}
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
