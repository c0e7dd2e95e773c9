"""A finding of each code: for the page of the documentation and the snapshot of their words."""

from typing import Final

from camctl.findings import Finding, Place

_FINDINGS = (
    Finding(code="note", details={"text": "the sentence of a note is its text"}),
    Finding(
        code="response_assumed",
        details={"response": "srgb 8 bit"},
        remedies={"calibrate_response": None},
    ),
    Finding(code="delay_unknown", remedies={"calibrate_delay": "v4l2:/dev/video0"}),
    Finding(code="delay_varies", value=3, details={"smallest": 2}),
    Finding(
        code="exposure_differs",
        frames=(0, 1),
        value=0.5,
        details={"expected": 4.0, "certain": True, "name": None, "before": None},
        remedies={"estimate_ratios": True},
    ),
    Finding(code="part_contradicts", frames=(0, 1), value=0.62, details={"compared": 0.031}),
    Finding(code="delay_contradicts", value=1, remedies={"calibrate_delay": "v4l2:/dev/video0"}),
    Finding(code="frame_white", frames=(0,), value=0.98, details={"metered": 0.01}),
    Finding(code="frame_damaged", frames=(2,), value=0.5),
    Finding(code="exposure_estimated", frames=(1, 0), value=1.021, low=1.019, high=1.023),
    Finding(code="not_estimated", details={"what": "the frames are black"}),
    Finding(code="setting_differs", value=0.02, details={"field": "base_s", "requested": 0.0213}),
    Finding(
        code="curve_repaired",
        details={"repair": "brightness 0.02 without light was subtracted"},
    ),
    Finding(code="flicker", value=0.004, details={"period_s": 0.01}),
    Finding(code="base_shortened", value=0.5, details={"stops": 1.5}),
    Finding(code="steps_cost_levels", value=61.0, details={"possible": 75.0}),
    Finding(code="time_differs", value=1.9, details={"planned_s": 1.2}),
    Finding(code="highlights_cut", value=0.012),
    Finding(
        code="light_above_range",
        value=0.081,
        details={"photographs": False},
        remedies={"compensation_stops": 0.0},
    ),
    Finding(
        code="light_below_range",
        value=0.34,
        details={"dynamic_range": 1000.0, "response": "log", "photographs": False, "left": 0.06},
        remedies={"dynamic_range": "auto", "count": 6},
    ),
    Finding(
        code="light_changed",
        value=0.09,
        details={"metered": 0.001},
        remedies={"compensation_stops": -0.5},
    ),
    Finding(code="picture_black", remedies={"base_s": None}),
    Finding(code="picture_white", value=0.999, remedies={"base_s": None}),
    Finding(
        code="light_spread",
        value=0.023,
        details={"photographs": False},
        remedies={"dynamic_range": 256.0, "compensation_stops": -2.0},
    ),
    Finding(
        code="moved",
        value=0.031,
        low=0.029,
        high=0.031,
        place=Place(top=216, left=184, bottom=408, right=472),
        details={"area": 0.058},
    ),
    Finding(code="noise_differs", value=41.2, details={"predicted": 63.5}),
    Finding(code="noise_unknown", value=0.25),
)
_PHOTOGRAPHS = (
    Finding(code="blurred", value=0.6, details={"file": "c.jpg", "left_out": True}),
    Finding(code="copy", frames=(2,), details={"file": "e.jpg", "other": "c.jpg"}),
    Finding(
        code="damaged",
        frames=(1,),
        details={"file": "b.jpg", "what": "812 bytes remain after the last row"},
    ),
    Finding(code="empty", details={"file": "d.jpg"}),
    Finding(code="exposure_corrected", frames=(1,), value=0.89, details={"factors": "b.jpg 0.89"}),
    Finding(code="label_unchecked", frames=(0,), details={"file": "a.jpg"}),
    Finding(
        code="label_unit",
        details={"times": "1/60 s is 1/64 s, 1/15 s is 1/16 s"},
        remedies={"labels": "exact"},
    ),
    Finding(
        code="label_wrong",
        frames=(2,),
        value=0.2,
        details={
            "file": "c.jpg",
            "stated_s": 4.0,
            "pixels_s": 0.8,
            "agree": 5,
            "left_out": False,
        },
        remedies={"times": None},
    ),
    Finding(
        code="labels_contradict",
        frames=(1, 0),
        value=0.5,
        details={"file": "b.jpg", "other": "a.jpg", "exposure": 4.0, "why": "tie"},
        remedies={"times": None},
    ),
    Finding(
        code="light_differs",
        frames=(4, 5),
        value=0.4,
        details={"files": "e.jpg, f.jpg", "count": 2, "left_out": False},
    ),
    Finding(
        code="masked",
        value=0.02,
        place=Place(top=32, left=4, bottom=748, right=505),
        details={"by": "mask"},
    ),
    Finding(code="other_view", value=0.1, details={"file": "c.jpg", "left_out": True}),
    Finding(
        code="other_white_balance",
        frames=(1,),
        value=1.15,
        details={"file": "b.jpg", "red": 1.15, "blue": 0.9},
    ),
    Finding(
        code="part_differs",
        frames=(12,),
        value=0.035,
        place=Place(top=689, left=0, bottom=716, right=374),
        details={"file": "m.jpg", "elsewhere": True},
    ),
    Finding(
        code="profile_unclear",
        details={"profiles": "ptp-maker-x-1 and ptp-maker-x-2"},
        remedies={"curve": None},
    ),
    Finding(
        code="response_unknown",
        details={"why": "the frames have too little in common"},
        remedies={"curve": None},
    ),
    Finding(
        code="shifted",
        value=9.0,
        details={"file": "e.jpg", "other": "d.jpg", "columns": -7, "rows": 5, "left_out": True},
    ),
    Finding(
        code="tags_differ",
        frames=(2,),
        details={"what": "orientation", "file": "c.jpg", "other": "a.jpg"},
    ),
)
_CALIBRATIONS = (
    Finding(
        code="exposures_contradict",
        frames=(3,),
        value=0.6,
        details={
            "kind": "label",
            "name": "d.tif",
            "channel": None,
            "stated": 0.125,
            "said": 0.2,
            "is_shot": False,
        },
        remedies={"times": None, "estimate_ratios": True},
    ),
    Finding(code="exponent_unknown", value=0.2, remedies={"times": None}),
    Finding(code="left_out", value=0.08, details={"what": "movement"}),
    Finding(code="levels_found", value=17, details={"level": "black", "largest": 255}),
    Finding(code="chart_contradicts", value=-0.12, details={"patch": 4, "channel": "G"}),
    Finding(code="profile_not_used", remedies={"calibrate_exposure": None}),
    Finding(code="response_doubtful", details={"why": "the camera or the scene moved"}),
    Finding(
        code="response_inexact",
        value=0.11,
        details={"brightness": 0.2, "needed": 0.07, "help": "add a frame of exposure 0.03"},
        remedies={"keep": True},
    ),
    Finding(code="noise_misfit", value=4.2, remedies={"calibrate_response": None}),
    Finding(code="noise_filtered", value=0.31),
    Finding(code="channels_differ", details={"each": "R 2.1, G 3.4, B 1.9", "channel": "G"}),
    Finding(code="not_measured", value=3, details={"what": "settings", "of": 12}),
    Finding(code="light_varies", value=0.013, details={"within": "pair"}),
    Finding(code="delay_irregular", value=2, details={"trials": 20}),
)
EXAMPLES: Final = {finding.code: finding for finding in (*_FINDINGS, *_PHOTOGRAPHS, *_CALIBRATIONS)}
"""One finding of each code of `camctl.findings.CODES`."""
