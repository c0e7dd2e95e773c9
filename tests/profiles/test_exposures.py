"""True exposures in a camera's profile: which settings they hold for, and how they join."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from camctl.interface.controls import ExposureSetting
from camctl.profiles.exposures import Correction, ExposureRecord


def entry(value: float, factor: float, half: float = 0.001) -> Correction:
    return Correction(value=value, factor=factor, low=factor * (1 - half), high=factor * (1 + half))


ONE = Correction(value=1.0, factor=1.0, low=1.0, high=1.0)


def record(*times: Correction, interpolates: bool = True) -> ExposureRecord:
    return ExposureRecord(
        times=times,
        gains=(ONE, entry(2.0, 1.1)),
        interpolates=interpolates,
        measured_at="2026-01-01T00:00:00+00:00",
    )


def factor_of(found: ExposureRecord, time_s: float, gain: float = 1.0) -> float | None:
    correction = found.correction(ExposureSetting(time_s, gain))
    return None if correction is None else correction.factor


def test_measured_settings_are_corrected_and_others_are_not() -> None:
    found = record(entry(0.01, 1.02), entry(0.02, 1.01), entry(0.1, 1.0))
    assert factor_of(found, 0.01) == 1.02
    assert factor_of(found, 0.02 * (1 + 1e-6)) == 1.01
    assert factor_of(found, 0.02, gain=2.0) == pytest.approx(1.01 * 1.1)
    assert factor_of(found, 0.02, gain=4.0) is None
    assert factor_of(found, 0.005) is None
    assert found.correction(ExposureSetting(0.02, 1.0, f_number=4.0)) is None


def test_times_between_measured_ones_are_interpolated_where_the_camera_has_them() -> None:
    times = (entry(0.01, 1.02, 0.002), entry(0.02, 1.0))
    middle = 0.01 * 2**0.5
    assert factor_of(record(*times), middle) == pytest.approx(1.01)
    assert factor_of(record(*times, interpolates=False), middle) is None
    correction = record(*times).correction(ExposureSetting(middle))
    assert correction is not None
    assert correction.low == pytest.approx(1.01 * 0.998)
    far = record(entry(0.01, 1.02), entry(0.05, 1.0))
    assert factor_of(far, 0.02) is None


def test_earlier_times_keep_their_ratios_when_records_are_joined() -> None:
    earlier = record(entry(0.01, 1.04), entry(0.02, 1.02), entry(0.04, 1.0))
    later = record(entry(0.04, 1.01), entry(0.08, 1.0))
    joined = later.joined(earlier)
    assert [each.value for each in joined.times] == [0.01, 0.02, 0.04, 0.08]
    assert [each.factor for each in joined.times] == pytest.approx([1.0504, 1.0302, 1.01, 1.0])
    assert joined.times[0].low < 1.0504 * 0.999
    apart = record(entry(1.0, 1.0), entry(2.0, 1.0))
    assert apart.joined(earlier).times == apart.times


def test_label_contradicts_outside_the_interval_only() -> None:
    assert entry(1.0, 1.02).contradicts_label
    assert not entry(1.0, 1.0005).contradicts_label


def test_record_survives_its_file_and_refuses_damage() -> None:
    found = record(entry(0.01, 1.02))
    text = found.model_dump_json()
    assert ExposureRecord.model_validate_json(text) == found
    for damage in ('"version":2', '"version":1,"more":1'):
        with pytest.raises(ValidationError):
            ExposureRecord.model_validate_json(text.replace('"version":1', damage))
    with pytest.raises(ValidationError):
        Correction(value=1.0, factor=1.0, low=1.1, high=1.2)
