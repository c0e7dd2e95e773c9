"""SequencerControl: a whole list of exposures is uploaded, and the camera takes it by itself."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.drivers.genicam.controls import ExposureControl
from camctl.drivers.genicam.port import FeatureError, Kind, OpenDevice
from camctl.errors import UsageError
from camctl.interface.controls import ExposureSetting

#: What makes a sequencer go on to its next set, in the order of preference: one step a frame.
_STEPS = ("ExposureEnd", "FrameEnd", "FrameStart", "ExposureStart", "FrameTrigger")
_NEEDED = (
    "SequencerConfigurationMode",
    "SequencerSetSelector",
    "SequencerSetSave",
    "SequencerSetNext",
)


def sets(device: OpenDevice) -> int:
    """Return how many sets a camera's sequencer has; 0: it has none."""
    if any(device.kind(name) is None for name in ("SequencerMode", *_NEEDED)):
        return 0
    return int(device.limits("SequencerSetSelector").maximum) + 1


def upload(
    device: OpenDevice, settings: Sequence[ExposureSetting], exposure: ExposureControl, name: str
) -> None:
    """Write a cycle of settings into the sequencer and turn it on; the acquisition is stopped.

    Raises:
        UsageError: the camera does not accept it
        RefusedSettingError: the camera applied another setting
    """
    try:
        device.write("SequencerMode", "Off")
        device.write("SequencerConfigurationMode", "On")
        _choose_features(device, exposure)
        for number, setting in enumerate(settings):
            device.write("SequencerSetSelector", number)
            exposure.forget()
            exposure.write(setting)
            _choose_next(device, (number + 1) % len(settings))
            device.execute("SequencerSetSave")
        if device.kind("SequencerSetStart") is not None:
            device.write("SequencerSetStart", 0)
        device.write("SequencerConfigurationMode", "Off")
        device.write("SequencerMode", "On")
    except FeatureError as error:
        turn_off(device)
        raise UsageError(
            f"the sequencer of {name} cannot be used: {error}",
            hint="leave it off",
            remedies={"option:sequencer": "off"},
        ) from error
    finally:
        exposure.forget()


def turn_off(device: OpenDevice) -> None:
    """Turn the sequencer off, in whatever state it is."""
    for feature in ("SequencerMode", "SequencerConfigurationMode"):
        try:
            device.write(feature, "Off")
        except FeatureError:
            continue  # it is off


def _choose_features(device: OpenDevice, exposure: ExposureControl) -> None:
    """Let the sets hold exposure time and gain, where a camera can choose what they hold."""
    if device.kind("SequencerFeatureSelector") is not Kind.ENUMERATION:
        return
    for feature in device.entries("SequencerFeatureSelector"):
        device.write("SequencerFeatureSelector", feature)
        if device.kind("SequencerFeatureEnable") is Kind.BOOLEAN:
            device.write(
                "SequencerFeatureEnable", feature in (exposure.time_name, exposure.gain_name)
            )


def _choose_next(device: OpenDevice, following: int) -> None:
    """Let the present set be followed by another after one frame."""
    if device.kind("SequencerPathSelector") is not None:
        device.write("SequencerPathSelector", 0)
    device.write("SequencerSetNext", following)
    if device.kind("SequencerTriggerSource") is Kind.ENUMERATION:
        offered = device.entries("SequencerTriggerSource")
        device.write(
            "SequencerTriggerSource", next((each for each in _STEPS if each in offered), offered[0])
        )
