"""What happens with a recorded body: it is opened and takes pictures, or it is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import permutations

import pytest
from ptp_bench import bench, shoot

from camctl.drivers.ptp.camera import PtpCamera
from camctl.errors import CamctlError
from camctl.interface.controls import Choices, Control, ExposureSetting
from camctl.sim.devices.ptp.body_facts import BodyFacts, load_body
from camctl.sim.devices.ptp.camera import PtpCamera as VirtualCamera

# Largest difference of a time from what the virtual body exposed, as a share.
_EXACT = 1e-6
_FULL_DIAL = 12
_TIME_CODES = (0x500D, 0xD100, 0xD102, 0xD20D, 0xD229, 0xD01C)


@dataclass(frozen=True)
class Outcome:
    """What happened with a body.

    Attributes:
        frames: how many were taken and fetched
        times, gains, f_numbers: how many settings, and the range of the times, s
        refusal: the error, if it was refused
    """

    frames: int = 0
    times: int = 0
    shortest_s: float = 0.0
    longest_s: float = 0.0
    gains: int = 0
    f_numbers: int = 0
    refusal: str = ""

    def __str__(self) -> str:
        """Return the outcome as a table's cell."""
        if self.refusal:
            return f"refused: {self.refusal}"
        times = f"{self.times} times, {_label(self.shortest_s)} to {_label(self.longest_s)} s"
        return f"shoots: {times}; {self.gains} ISO; {self.f_numbers} f"


def opened(name: str) -> str:
    """Open a body as it was recorded; return "opens", or why it is refused."""
    try:
        with bench(body=name, mode="recorded").camera():
            return "opens"
    except CamctlError as error:
        return f"refused: {_shown(str(error))}"


def turned_to_manual(name: str) -> Outcome:
    """Open a recorded body whose mode dial is at M, and take four pictures of three settings.

    Raises:
        AssertionError: a picture is not the one of its setting
    """
    pair = bench(body=name)
    try:
        with pair.camera() as camera:
            return _take(camera, pair.device)
    except CamctlError as error:
        return Outcome(refusal=_shown(str(error)))


def said(name: str) -> str:
    """Return what the recorded summary says of a body."""
    facts = load_body(name)
    items = []
    if facts.operations:
        items.append(f"{len(facts.operations)} operations")
    if facts.access is not None:
        items.append(("read-write", "read-only", "read-only with deletion")[facts.access])
    hidden = [code for code in (0xD100, 0xD054) if code in facts.hidden]
    if hidden:
        items.append(f"{' and '.join(f'{code:04X}' for code in hidden)} hidden")
    for code in _TIME_CODES:
        if code in facts.properties:
            count = len(facts.properties[code].choices)
            what = f"{count} choice{'s' * (count > 1)}" if count else "no list"
            kind = "" if facts.properties[code].writable else ", cannot be set"
            items.append(f"{code:04X}: {what}{kind}")
    return "; ".join(items) or "no operations, no times"


def row(name: str) -> str:
    """Return what is known of a body, and what happens with it, as a row of the table."""
    facts = load_body(name)
    recorded, outcome = opened(name), turned_to_manual(name)
    manual = str(outcome)
    if manual == recorded:
        manual = "the same"
    elif not outcome.refusal and not _has_recorded_dial(facts):
        manual += "; times not recorded"
    make = facts.make.split()[0].removesuffix(".Inc")
    model = facts.model.removeprefix(f"{make} ")
    cells = (f"{make} {model}", f"`{name}`", said(name), recorded, manual)
    return f"| {' | '.join(cells)} |"


def _has_recorded_dial(facts: BodyFacts) -> bool:
    """Return whether the record lists the shutter times of manual exposure."""
    dials = [facts.properties[code] for code in _TIME_CODES if code in facts.properties]
    return any(len(dial.choices) >= _FULL_DIAL for dial in dials)


def _take(camera: PtpCamera, device: VirtualCamera) -> Outcome:
    controls = camera.controls
    gain, f_number = controls.gain, controls.f_number
    lowest, widest = gain.minimum, f_number.minimum if f_number is not None else None
    times = [controls.time_s.nearest(t) for t in (1 / 250, 1 / 60, 1 / 15)]
    settings = [ExposureSetting(time_s, lowest, widest) for time_s in times]
    settings.append(ExposureSetting(times[0], gain.nearest(4 * lowest), widest))
    taken = device.body.taken
    frames = shoot(camera, settings)
    exposures = list(device.body.log)[taken:]
    # Where the camera has its times in units of 1e-4 s only, they are as far from the truth.
    rounding_s = 0.51e-4 if camera._dials.time_s.scale.unit is not None else 0.0
    assert len(frames) == len(exposures) == len(settings)
    for frame, setting, exposure in zip(frames, settings, exposures, strict=True):
        assert frame.applied == setting
        time_s = pytest.approx(setting.time_s, rel=_EXACT, abs=rounding_s)
        assert exposure["time_s"] == time_s, exposure
        assert exposure["gain"] == pytest.approx(setting.gain, rel=_EXACT), exposure
        name = frame.details["object"]
        assert name in exposure["names"]
    # The samples follow time and gain: where those of two frames differ, so does the light.
    exposed = [frame.applied.time_s * frame.applied.gain for frame in frames]
    light = [float(frame.pixels.mean()) for frame in frames]
    for more, less in permutations(range(len(frames)), 2):
        if exposed[more] > 1.5 * exposed[less]:
            assert light[more] > light[less], (exposed, light)
    return Outcome(
        len(frames),
        _count(controls.time_s),
        controls.time_s.minimum,
        controls.time_s.maximum,
        _count(gain),
        _count(f_number),
    )


def _count(control: Control | None) -> int:
    if control is None:
        return 0
    return len(control.values) if isinstance(control, Choices) else -1


def _label(time_s: float) -> str:
    return f"1/{1 / time_s:.0f}" if time_s < 0.3 else f"{time_s:g}"


def _shown(message: str) -> str:
    """Return an error without the name of the camera."""
    return re.sub(r"(^|of |)[^;:]{1,60}? at USB \d+:\d+", r"\1it", message)


#: Operations that take a picture, of the standard and of makers.
_TAKING = frozenset({0x100E, 0x101C, 0x90C0, 0x90CB, 0x9207, 0x920B, 0x910F, 0x9128, 0x901A})
#: With it Canon's compacts enter a mode in which alone they have settings and take pictures.
_POWERSHOT_MODE = 0x9008


def why_refused(name: str) -> str:
    """Return what the record of a body states that takes no pictures, and what it lacks."""
    facts = load_body(name)
    states_time = any(code in facts.properties for code in _TIME_CODES)
    if states_time:
        return "a shutter time that a computer cannot set"
    if not facts.all_operations & _TAKING:
        return "no operation that takes a picture"
    if facts.make.startswith("Canon") and _POWERSHOT_MODE in facts.operations:
        return "no shutter time: a compact of Canon outside its remote mode"
    return "an operation that takes a picture, and no shutter time"
