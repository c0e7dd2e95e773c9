"""What a notebook shows of plans and reports."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from sampling import some

import camctl
from camctl.findings import note
from camctl.system.picture_operations import png_pixels


class Cells(HTMLParser):
    """Collects the texts of a page, and which elements are open."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.mark.parametrize("sensor", some(["standard", "consumer"], every=2))
def test_a_plan_and_its_report(sensor: str) -> None:
    with camctl.open_camera("sim", sensor=sensor, size="1200x300") as camera:
        request = camctl.CaptureRequest(ratios=(1, 4), response="log", dynamic_range=1000)
        plan = camctl.plan_capture(camera, request)
        report = camctl.capture(camera, request, plan=plan)
    planned, reported = Cells(plan._repr_html_()), Cells(report._repr_html_())
    assert planned.open == reported.open == []
    assert planned.texts[:2] == ["desired", "log, 1:1,000"]
    assert f"{plan.settings[1].time_s:.4g}" in planned.texts
    assert f"{report.frames[1].applied_s:.4g}" in reported.texts
    assert any(
        text.startswith(f"{report.achieved.effective_levels:.4g}") for text in reported.texts
    )
    found = re.search(r"data:image/png;base64,([^\"]+)", report._repr_html_())
    assert found is not None
    pixels = png_pixels(base64.b64decode(found[1]))
    image = report.image()
    assert pixels.shape[:2] == (100, 400)
    assert pixels[5, 7].tolist() == (image[15, 21] >> 8).tolist()


def test_text_of_a_report_is_escaped_and_a_lost_picture_is_left_out(tmp_path: Path) -> None:
    with camctl.open_camera("sim", size="64x48") as camera:
        camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 2)), tmp_path / "here")
    (tmp_path / "here" / "image.tiff").unlink()
    report = camctl.read_report(tmp_path / "here")
    report.findings.append(note("<script>alert(1)</script>"))
    page = report._repr_html_()
    assert "<script>" not in page
    assert "<script>alert(1)</script>" in Cells(page).texts
    assert "<img" not in page
