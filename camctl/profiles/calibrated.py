"""A camera with what its profile says of it: the one place where calibrations are applied.

`camctl.open_camera` returns such a camera where the profile has measurements for the camera's mode.
Response, noise, true exposures, colours and hot pixels replace what the driver states of them; the
control delay and the formats of files are read by the drivers themselves, since they open a camera
with it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Mapping
from contextlib import nullcontext
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from camctl.errors import DataError, unknown_name
from camctl.interface.backends import CAMERAS, CameraBackend, load
from camctl.interface.camera import (
    Camera,
    PreviewingCamera,
    StreamingCamera,
)
from camctl.interface.controls import ExposureControls, ResponseOrigin
from camctl.interface.cycle import CyclingCamera
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.noise import DarkRecord
from camctl.profiles.profile import Profile, ignored_profiles, load_profile
from camctl.profiles.response import ResponseRecord
from camctl.system.interrupts import entering, uninterrupted

EXPOSURES, RESPONSE, NOISE, COLOUR = "exposures", "response", "noise", "colour"
PARTS = (EXPOSURES, RESPONSE, NOISE, COLOUR)
"""Parts of a profile that are applied to a camera."""

_log = logging.getLogger(__name__)


def with_profile(camera: Camera, parts: Collection[str] = PARTS) -> Camera:
    """Return an open camera with what its profile says of it; the camera itself without a profile.

    The profile is applied when the camera's controls are first asked for, which on some cameras
    takes a picture.  `CalibratedCamera.controls` raises `DataError` where the profile contradicts
    the camera.

    Args:
        camera: an open camera
        parts: of `PARTS`, those that are used

    Raises:
        DataError: the camera's profile is damaged
    """
    profile = load_profile(camera.info)
    measured = {
        EXPOSURES: profile.exposures,
        RESPONSE: profile.responses,
        NOISE: profile.noises,
        COLOUR: profile.colours,
    }
    if not any(measured[part] for part in parts):
        return camera
    able = (names for protocol, names in _ABILITIES.items() if isinstance(camera, protocol))
    abilities = {name: _passed_on(name) for names in able for name in names}
    kind = type("CalibratedCamera", (CalibratedCamera,), abilities)
    found: CalibratedCamera = kind(camera, profile, parts)
    return found


def calibrated(
    controls: ExposureControls, profile: Profile, parts: Collection[str] = PARTS
) -> ExposureControls:
    """Return the controls of a camera with what its profile says of its present mode.

    Raises:
        DataError: the profile contradicts the camera
    """
    mode = exposure_mode(controls)
    changes: dict[str, Any] = {}
    dates = {}
    if RESPONSE in parts and (response := profile.responses.get(mode)) is not None:
        _check_levels(controls, response, profile)
        changes |= response_changes(response)
        dates[RESPONSE] = response.measured_at
    if EXPOSURES in parts and (exposures := profile.exposures.get(mode)) is not None:
        changes["true_exposures"] = exposures
        dates[EXPOSURES] = exposures.measured_at
    if NOISE in parts and (noise := profile.noises.get(mode)) is not None:
        changes["noise"] = noise.noise_model()
        if noise.dark is not None:
            changes["hot_pixels"] = _hot_pixels(controls, noise.dark)
        dates[NOISE] = noise.measured_at
    if COLOUR in parts and (colour := profile.colours.get(mode)) is not None:
        changes["colour"] = colour.camera_colour()
        dates[COLOUR] = colour.measured_at
    if not dates:
        return controls
    days = {name: text[:10] for name, text in dates.items()}
    if len(set(days.values())) == 1:
        measured = f"{', '.join(days)}, measured {days.popitem()[1]}"
    else:
        measured = ", ".join(f"{name} measured {day}" for name, day in days.items())
    return replace(controls, **changes, profile=f"{profile.name}: {measured}")


def response_changes(record: ResponseRecord) -> dict[str, Any]:
    """Return the fields of the controls that a measured response replaces."""
    names = [channel.name for channel in record.channels]
    found = tuple(record.camera_response(name) for name in names)
    main = found[len(found) // 2]
    different = len({each.fingerprint for each in found}) > 1
    return {
        "response": main,
        "responses": found if different else (),
        "phase": record.phase,
        "response_origin": ResponseOrigin.MEASURED,
    }


def _hot_pixels(controls: ExposureControls, dark: DarkRecord) -> tuple[tuple[int, int], ...]:
    """Return the hot pixels that a frame has; a profile from a file may name others."""
    rows, columns = controls.shape
    found = [(pixel.row, pixel.column) for pixel in dark.hot_pixels]
    return tuple(pixel for pixel in found if pixel[0] < rows and pixel[1] < columns)


def _check_levels(controls: ExposureControls, record: ResponseRecord, profile: Profile) -> None:
    """Raise `DataError` unless a response was measured at the camera's levels and colours."""
    channels = 1 if controls.layout == "mono" else 3
    if len(record.channels) != channels:
        raise _unfit(profile, f"{len(record.channels)} channels", f"{channels} ({controls.layout})")
    for channel in record.channels:
        if (channel.black, channel.white) != (controls.black, controls.white):
            raise _unfit(
                profile,
                f"black {channel.black} and white {channel.white}",
                f"black {controls.black} and white {controls.white}",
            )


def _unfit(profile: Profile, measured: str, now: str) -> DataError:
    return DataError(
        f"the profile {profile.name} does not fit the camera: its response was measured with "
        f"{measured}, and the camera now has {now}",
        hint="set the camera as it was, calibrate it again, or leave the profile out",
        remedies={"calibrate_all": None, "option:profile": "none"},
    )


def _passed_on(name: str) -> Any:
    """Return an attribute that is the one of the camera itself."""
    return property(lambda calibrated: getattr(calibrated._camera, name))


#: What some cameras can do; a protocol looks for it in the class.
_ABILITIES: dict[type[Any], tuple[str, ...]] = {
    PreviewingCamera: ("preview",),
    StreamingCamera: ("mode", "step"),
    CyclingCamera: ("cycle",),
}


class CalibratedCamera:
    """A camera with what its profile says of it; see `camctl.Camera`.

    Everything but `controls` is taken from the camera itself, further attributes of its driver
    included.

    Args:
        camera: an open camera
        profile: of this camera
        parts: of `PARTS`, those that are used
    """

    info, clock, shoot = map(_passed_on, ("info", "clock", "shoot"))

    def __init__(self, camera: Any, profile: Profile, parts: Collection[str] = PARTS) -> None:
        self._camera = camera
        self._profile, self._parts = profile, parts
        self._stated: ExposureControls | None = None
        self._calibrated: ExposureControls | None = None

    @property
    def controls(self) -> ExposureControls:
        """The controls with the measured properties.

        Raises:
            DataError: the profile contradicts the camera
        """
        stated: ExposureControls = self._camera.controls
        if self._calibrated is None or stated is not self._stated:
            is_first = self._calibrated is None
            self._calibrated = calibrated(stated, self._profile, self._parts)
            self._stated = stated
            if is_first:
                self._report(self._calibrated)
        return self._calibrated

    def _report(self, controls: ExposureControls) -> None:
        if set(self._parts) != set(PARTS):  # a calibration, or a user who has chosen the parts
            return
        if controls.profile is not None:
            _log.info("using the profile %s", controls.profile)
            return
        if not controls.has_assumed_response and controls.noise is not None:
            return  # the driver states what the profile would replace
        profile = self._profile
        measured = profile.exposures, profile.responses, profile.noises, profile.colours
        modes = sorted({mode for records in measured for mode in records})
        _log.info(
            "no measurements for %s in the camera's profile, only for %s",
            exposure_mode(controls),
            ", ".join(modes),
        )

    @uninterrupted
    def close(self) -> None:
        """Disconnect from the camera; a second call does nothing."""
        self._camera.close()

    @entering
    def __enter__(self) -> Self:
        """Open the camera where it is not open, and return this one."""
        self._camera.__enter__()
        return self

    @uninterrupted
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the camera."""
        self._camera.__exit__(kind, error, trace)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the driver."""
        return getattr(self._camera, name)


def open_camera(
    camera_id: str, options: Mapping[str, Any] | None = None, /, **more_options: Any
) -> Camera:
    """Open a camera and return it; it is a context manager that closes the camera.

    Args:
        camera_id: name of the backend, and an address after a colon: "sim", "v4l2:/dev/video0"
        options: options of the backend; their values may be of any type that the backend's options
            model accepts, strings in any case.  None leaves an option at its default.  All
            cameras have the option "profile": "all" (the default), "none", or those parts of the
            camera's profile that are applied, such as "response,exposures".
        more_options: more of them, as keyword arguments

    Raises:
        UsageError: an unknown backend or option, or an invalid value
        DataError: the camera's profile is damaged
        CameraError: the camera cannot be opened

    >>> with open_camera("sim", scene="uniform", size="64x48") as camera:
    ...     camera.controls.shape
    (48, 64)
    """
    name, _, address = camera_id.partition(":")
    backend: CameraBackend = load(CAMERAS, "camera", name)()
    given = {
        option: os.fspath(value) if isinstance(value, os.PathLike) else value
        for option, value in {**(options or {}), **more_options}.items()
        if value is not None
    }
    parts = _profile_parts(given.pop("profile", "all"))
    camera: Camera | None = None
    try:
        with ignored_profiles() if not parts else nullcontext():
            camera = backend.open(address, given)
        return with_profile(camera, parts)
    except BaseException:
        if camera is not None:
            camera.close()
        raise


def _profile_parts(value: object) -> tuple[str, ...]:
    """Return the parts of a profile that the option "profile" names."""
    words = [word.strip() for word in str(value).split(",")]
    if words == ["all"]:
        return PARTS
    if words == ["none"]:
        return ()
    for word in words:
        if word not in PARTS:
            raise unknown_name("part of a profile", word, ("all", "none", *PARTS))
    return tuple(words)
