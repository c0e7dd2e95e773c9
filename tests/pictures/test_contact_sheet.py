"""Contact sheets: any number of frames, of any shape, without overlaps."""

from __future__ import annotations

import numpy as np
import pytest
from picture_parts import details, light_of
from sampling import some

from camctl.evidence.movement import FoundMovement, Movement
from camctl.interface.controls import ExposureControls, Layout, ResponseOrigin, Steps
from camctl.model.response.camera import standard_response
from camctl.pictures import contact_sheet as sheets
from camctl.pictures import drawing
from camctl.pictures.contact_sheet import contact_sheet
from camctl.pictures.details import THUMBNAIL_SIDE, thumbnail
from camctl.pictures.drawing import LINE_HEIGHT, MARGIN, Drawing
from camctl.pictures.preview import tone_map
from camctl.system.picture_operations import draw_text, text_width

SHAPES = [(1, 1), (3, 4), (60, 80), (80, 60, 3), (300, 20), (20, 300, 3)]


class _Boxes:
    """Records where a drawing puts text and pictures."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.boxes: list[tuple[str, int, int, int, int]] = []

        def record_text(pixels, text, place, size, colour):  # type: ignore[no-untyped-def]
            left, top = place[0], place[1] - round(22 * size)
            box = (left, top, left + text_width(text, size), place[1] + round(5 * size))
            self.boxes.append((text, *box))
            draw_text(pixels, text, place, size, colour)

        picture = Drawing.picture

        def record_picture(sheet, shown, place, size):  # type: ignore[no-untyped-def]
            self.boxes.append(("picture", *place, place[0] + size[0], place[1] + size[1]))
            return picture(sheet, shown, place, size)

        monkeypatch.setattr(drawing, "draw_text", record_text)
        monkeypatch.setattr(Drawing, "picture", record_picture)

    def overlaps(self) -> list[tuple[str, str]]:
        found = []
        for k, (name, left, top, right, bottom) in enumerate(self.boxes):
            for other, x, y, x_end, y_end in self.boxes[:k]:
                if left < x_end and x < right and top < y_end and y < bottom:
                    found.append((name, other))
        return found


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", some([1, 2, 5, 8, 9, 16], every=2))
def test_nothing_overlaps_or_leaves_the_sheet(
    shape: tuple[int, ...], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    boxes = _Boxes(monkeypatch)
    light = light_of(np.linspace(0.01, 1.0, int(np.prod(shape))).reshape(shape))
    picture = tone_map(light)
    sheet = contact_sheet(light, picture, details(count, picture))
    assert sheet.shape[1:] == (1280, 3)
    assert boxes.overlaps() == []
    for name, left, top, right, bottom in boxes.boxes:
        assert min(left, top) >= 0, name
        assert right <= 1280, name
        assert bottom <= len(sheet), name
    texts = [name for name, *_ in boxes.boxes if name != "picture"]
    assert sum("% saturated" in text for text in texts) == count
    assert boxes.boxes[-1][4] > len(sheet) - 40  # no empty space at the end


def colour_share(pixels: np.ndarray, colour: tuple[int, int, int]) -> float:
    return float((pixels == colour).all(axis=-1).mean())


def test_marks_are_where_light_is_out_of_range() -> None:
    rows, columns = 60, 80
    light = np.full((rows, columns), 0.1)
    saturated, dark = np.zeros_like(light), np.zeros_like(light)
    moved, spread = np.zeros((2, 6, 8), bool)
    saturated[:, :20], dark[:, 20:40], moved[:, 4:6] = 1, 1, True
    spread[:, 6:] = True
    shown = light_of(light, saturated=saturated, dark=dark)
    found = FoundMovement(0.2, 0.002, ())
    marks = np.zeros((rows, columns // 8), np.uint8)
    movement = Movement((rows, columns), marks, found, 10, moved, spread)
    pixels = contact_sheet(shown, tone_map(shown), details(), movement)
    top = MARGIN + 2 * LINE_HEIGHT + 5
    second = pixels[top : top + 400, 648:1264]
    width = second.shape[1] // 4
    colours = (
        sheets._SATURATED_COLOUR,
        sheets._DARK_COLOUR,
        sheets._MOVED_COLOUR,
        sheets._SPREAD_COLOUR,
    )
    for place, colour in enumerate(colours):
        part = second[:, place * width + 12 : (place + 1) * width - 12]
        assert colour_share(part, colour) > 0.99
        for other in colours:
            assert other == colour or colour_share(part, other) == 0


def test_marks_are_as_large_as_the_pixels_of_an_enlarged_picture() -> None:
    light, dark = np.full((72, 96), 0.1), np.zeros((72, 96))
    dark[10:13, 20], dark[40, 50], dark[70, 90:] = 1, 1, 1
    shown = light_of(light, dark=dark)
    pixels = contact_sheet(shown, tone_map(shown), details())
    rows, columns = 460, 613
    second = pixels[MARGIN + 2 * LINE_HEIGHT :, 649 : 649 + columns]
    is_marked = (second[:rows] == sheets._DARK_COLOUR).all(axis=-1)
    enlarged = dark[np.arange(rows) * 72 // rows][:, np.arange(columns) * 96 // columns]
    assert np.array_equal(is_marked, enlarged > 0)


def test_a_single_saturated_pixel_is_marked() -> None:
    light, saturated = np.full((1500, 2000), 0.1), np.zeros((1500, 2000))
    saturated[700, 900] = 1
    shown = light_of(light, saturated=saturated)
    pixels = contact_sheet(shown, tone_map(shown), details())
    assert colour_share(pixels[60:500], sheets._SATURATED_COLOUR) > 0


def test_histogram_counts_every_sample_that_was_reached() -> None:
    light = light_of(np.geomspace(1e-3, 1.0, 4000).reshape(40, 100) * 0.999)
    shares, first, last = sheets._histogram(light, details())
    assert (first, last) == (-4, 0) or first <= -3
    assert shares.sum() == pytest.approx(1.0, abs=2e-3)
    bins = shares[0][(-3 - first) * 24 :]
    assert bins.min() > 0.5 / len(bins)  # flat in the logarithm


def controls_of(layout: Layout, shape: tuple[int, int], response: bool = False) -> ExposureControls:
    curve = standard_response("gamma-2.2", 8) if response else None
    white = 16 + curve.M if curve is not None else 250
    return ExposureControls(
        Steps(1e-4, 1.0),
        shape,
        layout,
        9,
        black=16,
        white=white,
        response=curve,
        response_origin=ResponseOrigin.STATED,
    )


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (5, 7), (900, 1200), (1200, 500)])
def test_thumbnails_of_all_layouts_and_sizes(layout: Layout, shape: tuple[int, int]) -> None:
    colours = (3,) if layout is Layout.RGB else ()
    small = thumbnail(np.full((*shape, *colours), 250, np.uint16), controls_of(layout, shape))
    assert max(small.shape) <= THUMBNAIL_SIDE
    assert (small == 255).all()
    black = thumbnail(np.full((*shape, *colours), 9, np.uint16), controls_of(layout, shape))
    assert (black == 0).all()


@pytest.mark.parametrize("layout", [layout for layout in Layout if layout.is_mosaic])
def test_thumbnail_of_a_mosaic_has_its_colours(layout: Layout) -> None:
    cell = np.array(
        [["RGB".index(layout.value.upper()[2 * r + c]) for c in (0, 1)] for r in (0, 1)]
    )
    frame = np.array([16, 100, 250], np.uint16)[np.tile(cell, (20, 30))]
    small = thumbnail(frame, controls_of(layout, (40, 60)))
    assert small.shape == (20, 30, 3)
    assert (small == small[0, 0]).all()
    assert small[0, 0, 0] == 0
    assert small[0, 0, 2] == 255
    assert 150 < small[0, 0, 1] < 165
