"""contact.png: the picture, its frames, and the light with the part that each exposure reaches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.movement import Movement
from camctl.pictures.details import PictureDetails, ShownFrame
from camctl.pictures.drawing import (
    INK,
    LINE_HEIGHT,
    MARGIN,
    MOST_ENLARGED,
    PALE,
    SMALL_TEXT,
    TITLE,
    Colour,
    Drawing,
    decades,
    reduced,
)
from camctl.pictures.preview_light import ALL, Light
from camctl.system.number_text import percent_text, power_texts, range_text, time_text
from camctl.system.picture_operations import channels_together, reduced_by_area

_WIDTH = 1280  # pixels: fits on the screens of laptops
_INNER = _WIDTH - 2 * MARGIN
_HALF = (_INNER - MARGIN) // 2
#: Largest height of the two pictures, and of a frame.
_PICTURE_HEIGHT, _FRAME_HEIGHT = 460, 232
#: Frames side by side at most, and places for frames at least.
_MOST_IN_ROW, _LEAST_IN_ROW = 8, 4
#: Height of the histogram, and of the line of an exposure under it.
_HISTOGRAM_HEIGHT, _BAR_HEIGHT = 170, 17
#: Width of the labels left of the histogram.
_LABELS = 176
#: Pixels a side that are counted for the histogram, at most.
_HISTOGRAM_SIDE = 800
#: Decades that are drawn at most, below the brightest.
_MOST_DECADES = 12
#: Share of the samples that the histogram does not draw, from which it says so.
_LEAST_HIDDEN = 1e-4
#: Share of dark samples from which a pixel is marked: one of its three channels.
_NOTABLY_DARK = 0.3
_SATURATED_COLOUR: Colour = (222, 32, 32)
_DARK_COLOUR: Colour = (40, 90, 230)
_MOVED_COLOUR: Colour = (250, 200, 0)
_SPREAD_COLOUR: Colour = (240, 120, 200)
_RANGE_COLOUR: Colour = (226, 234, 222)
_BAR_COLOUR: Colour = (120, 130, 150)
_GRID_COLOUR: Colour = (205, 205, 205)
#: Weights of R, G and B in grey (ITU-R BT.601).
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_CHANNEL_COLOURS: dict[int, tuple[Colour, ...]] = {
    1: ((90, 90, 90),),
    3: ((200, 40, 40), (30, 140, 40), (40, 70, 210)),
}


def contact_sheet(
    light: Light,
    preview: NDArray[np.uint8],
    details: PictureDetails,
    movement: Movement | None = None,
) -> NDArray[np.uint8]:
    """Return the contact sheet of a capture in sRGB, (rows, 1280, 3).

    Args:
        light: of the picture
        preview: the picture for people, in the size of `light` turned upright
        details: of the capture
        movement: where frames contradict each other; None: not examined
    """
    rows = _frame_rows(details.frames)
    cell, frame_height = _cell(rows)
    picture = _box(preview, _HALF, _PICTURE_HEIGHT)
    bars = len(details.frames) * _BAR_HEIGHT
    tops = np.cumsum(
        [
            MARGIN,
            2 * LINE_HEIGHT,
            picture + LINE_HEIGHT + MARGIN,
            len(rows) * (frame_height + 2 * LINE_HEIGHT + MARGIN),
            LINE_HEIGHT + 4 + _HISTOGRAM_HEIGHT + bars + 2 * LINE_HEIGHT + MARGIN,
        ]
    ).tolist()
    sheet = Drawing(_WIDTH, tops[-1])
    sheet.text(_title(details), (MARGIN, tops[0]), _INNER, size=TITLE)
    shown, lies = reduced(preview, (_HALF, _PICTURE_HEIGHT)), details.orientation
    marked = lies.upright(_marked(light, lies.lying(shown), movement))
    _draw_pictures(sheet, (tops[1], picture), shown, marked, details)
    for number, row in enumerate(rows):
        top = tops[2] + number * (frame_height + 2 * LINE_HEIGHT + MARGIN)
        for place, frame in enumerate(row):
            left = MARGIN + place * (cell + MARGIN)
            _draw_frame(sheet, frame, (left, top), (cell, frame_height))
    _draw_light(sheet, tops[3], light, details)
    return sheet.pixels


def _title(details: PictureDetails) -> str:
    count = len(details.frames)
    parts = [
        details.camera.name,
        f"{details.desired}, {range_text(details.highest / details.lowest)}"
        if details.lowest > 0
        else details.desired,
        f"{count} exposures" if count > 1 else "1 exposure",
    ]
    if details.taken_at is not None:
        parts.append(f"{details.taken_at:%Y-%m-%d %H:%M}")
    return "   ".join(parts)


def _frame_rows(frames: tuple[ShownFrame, ...]) -> list[tuple[ShownFrame, ...]]:
    """Return the frames in rows of about the same length."""
    rows = -(-len(frames) // _MOST_IN_ROW)
    length = -(-len(frames) // rows)
    return [frames[start : start + length] for start in range(0, len(frames), length)]


def _cell(rows: list[tuple[ShownFrame, ...]]) -> tuple[int, int]:
    """Return the width of the place of a frame, and the height of the frames."""
    places = max(_LEAST_IN_ROW, len(rows[0]))
    width = (_INNER - (places - 1) * MARGIN) // places
    heights = (_box(frame.thumbnail, width, _FRAME_HEIGHT) for row in rows for frame in row)
    return width, max(heights)


def _box(picture: NDArray[np.uint8], width: int, most: int) -> int:
    """Return the height of a picture fitted into `width` and a height of at most `most`."""
    rows, columns = map(int, picture.shape[:2])
    return max(1, min(most, MOST_ENLARGED * rows, round(rows * width / columns)))


def _draw_pictures(
    sheet: Drawing,
    place: tuple[int, int],
    preview: NDArray[np.uint8],
    marked: NDArray[np.uint8],
    details: PictureDetails,
) -> None:
    """Draw the picture and its marks side by side; `place` is their top and their height."""
    (top, height), width = place, _HALF
    second = MARGIN + width + MARGIN
    sheet.picture(preview, (MARGIN, top), (width, height))
    sheet.picture(marked, (second, top), (width, height))
    below = top + height + 2
    sheet.text("preview.png", (MARGIN, below), width)
    legend = [
        (_SATURATED_COLOUR, f"saturated: {percent_text(details.saturated)}"),
        (_DARK_COLOUR, f"too dark: {percent_text(details.dark)}"),
    ]
    if details.moved is not None:
        legend.append((_MOVED_COLOUR, f"frames disagree: {percent_text(details.moved)}"))
    if details.spread:
        legend.append((_SPREAD_COLOUR, f"light spread: {percent_text(details.spread)}"))
    step = width // len(legend)
    for number, (colour, text) in enumerate(legend):
        left = second + number * step
        sheet.fill((left, below + 3), (11, 11), colour)
        sheet.text(text, (left + 16, below), step - 20)


def _marked(
    light: Light, preview: NDArray[np.uint8], movement: Movement | None
) -> NDArray[np.uint8]:
    """Return the preview, (rows, columns, 3), in grey with the marks, of which each is seen."""
    pale = np.rint(0.55 * (preview @ _LUMA) + 70).astype(np.uint8)
    marked = channels_together([pale] * 3)
    shape = (marked.shape[1], marked.shape[0])
    marks = [
        (light.dark > _NOTABLY_DARK * ALL, _DARK_COLOUR),
        (light.saturated > 0, _SATURATED_COLOUR),
    ]
    if movement is not None:
        spread, moved = (movement.spread_cells, _SPREAD_COLOUR), (movement.cells, _MOVED_COLOUR)
        marks[1:1] = spread, moved
    for mark, colour in marks:
        if not mark.any():
            continue
        shown = reduced_by_area(mark.astype(np.float32), shape)
        marked[shown > 0 if colour is _SATURATED_COLOUR else shown >= 0.5] = colour
    return marked


def _draw_frame(
    sheet: Drawing, frame: ShownFrame, place: tuple[int, int], size: tuple[int, int]
) -> None:
    sheet.picture(frame.thumbnail, place, size)
    below = place[1] + size[1] + 2
    sheet.text(_setting_text(frame), (place[0], below), size[0])
    text = f"{percent_text(frame.saturated)} saturated"
    sheet.text(text, (place[0], below + LINE_HEIGHT), size[0], size=SMALL_TEXT, colour=PALE)


def _setting_text(frame: ShownFrame) -> str:
    parts = [time_text(frame.applied.time_s)]
    if frame.applied.gain != 1.0:
        parts.append(f"gain {frame.applied.gain:.3g}")
    if frame.applied.f_number is not None:
        parts.append(f"f/{frame.applied.f_number:.2g}")
    return ", ".join(parts)


def _draw_light(sheet: Drawing, top: int, light: Light, details: PictureDetails) -> None:
    """Draw the histogram, and under it what each exposure reaches."""
    frames = details.frames
    shares, first, last = _histogram(light, details)
    left, width = MARGIN + _LABELS, _INNER - _LABELS - 2 * MARGIN
    bars_top = top + LINE_HEIGHT + 4 + _HISTOGRAM_HEIGHT
    bottom = bars_top + len(frames) * _BAR_HEIGHT

    def x_of(irradiance: float) -> int:
        place = (math.log10(max(irradiance, 1e-300)) - first) / (last - first)
        return left + round(min(max(place, 0.0), 1.0) * width)

    title = "light: share of the samples by irradiance (height: square root of the share)"
    hidden = 1 - float(shares.sum(axis=1).mean())
    if hidden > _LEAST_HIDDEN:
        title += f"; not drawn: {percent_text(hidden)}, which no frame shows"
    sheet.text(title, (left, top), width)
    low, high = x_of(details.lowest), x_of(details.highest)
    top += LINE_HEIGHT + 4
    sheet.fill((low, top), (max(1, high - low), bottom - top), _RANGE_COLOUR)
    for exponent, text in zip(range(first, last + 1), power_texts(first, last), strict=True):
        x = x_of(10.0**exponent)
        sheet.fill((x, top), (1, bottom - top + 1), _GRID_COLOUR)
        sheet.text(text, (x - 30, bottom + 3), 60, size=SMALL_TEXT, align=0.5)
    heights = np.sqrt(shares / max(float(shares.max()), 1e-12)) * (_HISTOGRAM_HEIGHT - 6)
    edges = left + np.linspace(0, width, shares.shape[1] + 1)
    for values, colour in zip(heights, _CHANNEL_COLOURS[len(shares)], strict=True):
        xs, ys = np.rint(edges).astype(int), np.rint(bars_top - values).astype(int)
        for begin, end, y in zip(xs, xs[1:], ys, strict=False):
            sheet.fill((begin, y), (end - begin + 1, 1), colour)
        for x, first_y, last_y in zip(xs[1:], ys, ys[1:], strict=False):
            sheet.fill((x, min(first_y, last_y)), (1, abs(last_y - first_y) + 1), colour)
    sheet.fill((left, bars_top), (width + 1, 1), INK)
    for number, frame in enumerate(frames):
        y = bars_top + number * _BAR_HEIGHT
        begin, end = x_of(frame.lowest), x_of(frame.highest)
        sheet.fill((begin, y + 5), (max(2, end - begin), _BAR_HEIGHT - 9), _BAR_COLOUR)
        sheet.text(_setting_text(frame), (MARGIN, y + 1), _LABELS - 10, size=SMALL_TEXT, align=1.0)
    sheet.text(
        f"irradiance ({details.unit}); bars: from the first level of each exposure to where it is "
        "saturated; green: the desired range",
        (left, bottom + LINE_HEIGHT),
        width,
        size=SMALL_TEXT,
        colour=PALE,
    )


def _histogram(light: Light, details: PictureDetails) -> tuple[NDArray[np.float64], int, int]:
    """Return the share of the samples in each bin, (channels, bins), and the first and last decade.

    Pixels without any light are left out: their irradiance is not known.
    """
    # Some pixels show the shares as well as all do.
    every = -(-max(light.unlit.shape) // _HISTOGRAM_SIDE)
    unlit = light.unlit[::every, ::every]
    seen = light.irradiance[::every, ::every][unlit < ALL]
    logs = np.log10(np.maximum(seen, 1e-30))
    lowest = [frame.lowest for frame in details.frames if frame.lowest > 0]
    low = min([details.lowest or details.highest, *lowest])
    high = max([details.highest, *(frame.highest for frame in details.frames)])
    if logs.size:
        # All but the darkest thousandth: noise can leave any small number.
        low = min(low, float(10 ** np.percentile(logs, 0.1)))
        high = max(high, float(10 ** logs.max()))
    first, last = decades(low, high)
    first = max(first, last - _MOST_DECADES)
    edges = np.linspace(first, last, (last - first) * 24 + 1)
    counts = [np.histogram(channel, edges)[0] for channel in logs.T]
    return np.array(counts) / max(1, unlit.size), first, last
