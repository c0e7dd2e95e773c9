"""Requests: which are refused, and the desired responses of one's own."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from sampling import some
from small_cameras import small_camera

from camctl.captures.plan import plan_capture
from camctl.captures.sequencer import capture
from camctl.errors import DataError, UsageError
from camctl.exposure.goal import RANGE_WITHOUT_LIGHT, CaptureRequest
from camctl.model.response.desired import GammaDesired, LinearDesired
from camctl.model.response.names import RANGES
from camctl.records.folder_store import read_capture

CURVE = ((0.01, 0.0), (0.1, 0.6), (1.0, 1.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"response": "gama"}, "unknown response 'gama'; did you mean gamma?"),
        ({"response": "auto", "dynamic_range": math.inf}, "finite dynamic range"),
        (
            {"response": "auto", "dynamic_range": 1.0},
            "invalid dynamic range 1: expected a number above 1",
        ),
        ({"gamma": 0.4}, "gamma 0.4 does not apply to the response 'log'; choose the response"),
        (
            {"response": "auto", "gamma": 0.4},
            "gamma 0.4 does not apply to the response 'auto'; choose the response 'gamma', or",
        ),
        ({"response": "gamma", "gamma": -1.0}, "invalid gamma .*-1"),
        ({"desired_curve": CURVE}, "a desired curve does not apply to the response 'log'"),
        ({"response": "curve"}, "the response 'curve' needs a desired curve; give pairs of"),
        ({"response": "curve", "desired_curve": ()}, "invalid desired response .curve.: .*"),
        (
            {"response": "curve", "desired_curve": ((1.0, 0.0, 3.0), (2.0, 1.0, 3.0))},
            "invalid desired curve: expected pairs of irradiance and brightness",
        ),
        (
            {"response": "curve", "desired_curve": ((1.0, 0.0), (0.5, 1.0))},
            "invalid desired response .curve.: irradiance must be positive and increase",
        ),
        (
            {"response": "curve", "desired_curve": ((0.1, 1.0), (0.5, 0.0))},
            "invalid desired response .curve.: u must not decrease",
        ),
        (
            {"response": "curve", "desired_curve": ((0.1, math.nan), (0.5, 0.0))},
            "invalid desired response .curve.: .*finite",
        ),
        ({"compensation_stops": 2000.0}, "invalid compensation 2000: expected -64 to 64 stops"),
        ({"levels_wanted": 1e308}, "invalid number of desired levels 1e"),
        ({"count": 0}, "invalid number of exposures 0: expected 1 to 64"),
        ({"count": 65}, "invalid number of exposures 65: expected 1 to 64"),
        ({"count": 2.5}, "invalid number of exposures 2.5: expected a whole number"),
        ({"dynamic_range": "mediun"}, "unknown dynamic range 'mediun'; did you mean medium?"),
        ({"dynamic_range": None}, "invalid dynamic_range None: expected a number"),
        ({"clip_percent": 1, "base_s": 0.1}, "a share of clipped samples needs metering"),
        ({"clip_percent": 51}, "invalid share of clipped samples 51 %: expected 0 to 50 %"),
        ({"clip_percent": math.nan}, "invalid share of clipped samples nan %"),
        ({"ratios": "1,2"}, "invalid ratios '1,2': expected numbers such as"),
        ({"ratios": ()}, "no exposure ratios: expected at least one, such as 1,2,4"),
        ({"ratios": (1.0, 0.0)}, "invalid exposure ratio 0: expected a positive, finite number"),
        ({"ratios": (math.nan,)}, "invalid exposure ratio nan: expected a positive, finite"),
        ({"base_s": -1.0}, "invalid base exposure in seconds -1: expected a positive, finite"),
        ({"levels_wanted": 0.0}, "invalid number of desired levels 0: expected 1 to 10,000,000"),
        ({"time_budget_s": 0.0}, "invalid time budget in seconds 0: expected a positive, finite"),
        ({"mains_hz": 100}, "invalid mains frequency 100 Hz: expected 50 or 60"),
        ({"compensation_stops": math.inf}, "invalid compensation inf: expected -64 to 64 stops"),
        ({"tolerance": -1.0}, "invalid tolerance -1: expected a number of levels from 0"),
        (
            {"tolerance": 1.0},
            "a tolerance needs the number of desired levels; give it as levels_wanted",
        ),
        (
            {"tolerance": 1.0, "levels_wanted": 10.0, "time_budget_s": 1.0},
            "a tolerance cannot be combined with a time budget or an automatic response; leave",
        ),
        (
            {"tolerance": 1.0, "levels_wanted": 10.0, "response": "auto"},
            "a tolerance cannot be combined with a time budget or an automatic response; leave",
        ),
        (
            {"tolerance": 1.0, "levels_wanted": 10.0, "ratios": (1.0, 2.0)},
            "a tolerance cannot be combined with ratios; leave one of them out",
        ),
        (
            {"response": "auto", "ratios": (1.0, 2.0)},
            "an automatic response cannot be combined with ratios; leave one",
        ),
        (
            {"response": "auto", "base_s": 0.01},
            "an automatic response needs metering, and the base exposure is given; leave the base",
        ),
    ],
)
def test_invalid_request_is_a_usage_error_of_one_line(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message) as failure:
        CaptureRequest(**fields)
    assert "\n" not in str(failure.value)


def test_names_of_ranges_are_numbers_and_without_light_auto_is_medium() -> None:
    names: tuple[Literal["low", "medium", "high"], ...] = ("low", "medium", "high")
    assert [CaptureRequest(dynamic_range=each).given_range for each in names] == [*RANGES.values()]
    assert CaptureRequest().given_range is None
    assert CaptureRequest(base_s=0.01).given_range == RANGE_WITHOUT_LIGHT == RANGES["medium"]
    assert CaptureRequest(base_s=0.01, dynamic_range="high").given_range == RANGES["high"]


def test_exponent_of_gamma_is_one_half_without_another() -> None:
    default = CaptureRequest("gamma", 1000.0).desired
    assert isinstance(default, GammaDesired)
    assert default.gamma == 0.5
    other = CaptureRequest("gamma", 1000.0, gamma=0.45).desired
    assert isinstance(other, GammaDesired)
    assert other.gamma == 0.45
    assert isinstance(CaptureRequest("gamma", 1000.0, gamma=1.0).desired, LinearDesired)


def test_curve_has_its_own_dynamic_range() -> None:
    desired = CaptureRequest("curve", desired_curve=CURVE).desired
    assert desired is not None
    assert desired.dynamic_range == pytest.approx(100)
    assert desired.u([0.01, 0.1, 1.0]).tolist() == pytest.approx([0, 0.6, 1])


@pytest.mark.parametrize(
    "request_",
    some(
        [
            CaptureRequest("gamma", 256.0, 2, gamma=0.45),
            CaptureRequest("curve", count=2, desired_curve=CURVE),
        ],
        every=2,
    ),
    ids=["gamma", "curve"],
)
def test_desired_response_reaches_plan_report_and_image(
    request_: CaptureRequest, tmp_path: Path
) -> None:
    desired = request_.desired
    assert desired is not None
    with small_camera("ideal-8") as camera:
        report = capture(camera, request_, tmp_path / "out")
    assert report.plan.response == request_.response
    assert report.plan.dynamic_range == desired.dynamic_range
    saved = read_capture(tmp_path / "out")
    assert (saved.request, saved.plan) == (request_, report.plan)
    E = np.geomspace(1e-3, 1, 99)
    assert saved.plan.desired.u(E).tolist() == desired.u(E).tolist()
    # The image is the desired response of the radiance, to rounding, but for the level that
    # contains the end of the range: the image has its part within the range.
    unit = report.irradiance.full_scale_exposure
    irradiance = report.radiance() * unit
    # The radiance is rounded to steps whose deviation, a sqrt(12)th, is at most a 10th of its own.
    step = report.standard_deviation() * unit * np.sqrt(12) / 10
    darkest, brightest = (desired.u(irradiance + each * step / 2) for each in (-1, 1))
    code = report.image()
    is_close = (code >= 65535 * darkest - 1) & (code <= 65535 * brightest + 1)
    assert is_close[(irradiance > 2 * desired.e_min) & (report.mask() == 0)].all()


def test_exponents_have_plans_of_their_own() -> None:
    plans = []
    for gamma in (0.3, 0.5, 0.9):
        with small_camera() as camera:
            request = CaptureRequest("gamma", 1000.0, 2, gamma=gamma, base_s=0.01)
            plans.append(plan_capture(camera, request))
    assert plans[0].exposures[1] > plans[1].exposures[1] > plans[2].exposures[1]
    with small_camera() as camera:
        default = plan_capture(camera, replace(request, gamma=None))
    assert default.exposures == plans[1].exposures


def test_report_with_an_invalid_request_is_a_data_error(tmp_path: Path) -> None:
    with small_camera() as camera:
        capture(camera, CaptureRequest(ratios=(1.0, 2.0)), tmp_path / "out")
    path = tmp_path / "out" / "report.json"
    path.write_text(path.read_text().replace('"request": {', '"request": {"gamma": 0.4,'))
    with pytest.raises(DataError, match=r"report\.json is damaged: gamma 0\.4 does not apply"):
        read_capture(tmp_path / "out")


def test_lists_and_arrays_become_tuples_of_plain_numbers() -> None:
    """A request can be compared, hashed, and written to a report whatever it was made from."""
    expected = CaptureRequest(response="curve", desired_curve=CURVE, ratios=(1.0, 4.0))
    for curve, ratios in (
        (np.array(CURVE), np.array([1.0, 4.0])),
        ([list(pair) for pair in CURVE], [1.0, 4.0]),
    ):
        made: Any = {"desired_curve": curve, "ratios": ratios}
        assert CaptureRequest(response="curve", **made) == expected
        assert hash(CaptureRequest(response="curve", **made)) == hash(expected)


@pytest.mark.parametrize("curve", [(1, 2), 3, ((0.1, 0.2, 0.3),), (("dark", 0.0), (1.0, 1.0))])
def test_curve_of_something_else_than_pairs_is_a_usage_error(curve: Any) -> None:
    with pytest.raises(UsageError, match="expected pairs of irradiance and brightness"):
        CaptureRequest(response="curve", desired_curve=curve)
