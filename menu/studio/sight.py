"""What the camera sees, for browsers that look: live pictures are made only while one does.

Each sample is kept as one byte: 0 too dark, 255 saturated, between them the brightness as shown.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.light import SHOWN_STOPS, Metering, counts_in_stops
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureControls, Layout
from camctl.menu.thumbnails import gradient
from camctl.system.picture_operations import jpeg, opencv, png, reduced_by_area

if TYPE_CHECKING:
    from camctl.livestream.planning import Look as Light
    from camctl.livestream.result import LiveResult

Codes = NDArray[np.uint8]

_LOOKS_S = 5.0
"""So long after its last request a browser still counts as looking, s."""
_SILENCE_S = 5.0
"""A request for the next picture is answered after this time, s, even if there is none."""
_TOO_DARK, _SATURATED = 0, 255
_QUALITY = 85
"""Quality of the JPEG files, 1 to 100."""
_DISPLAY_GAMMA = 2.2  # IEC 61966-2-1 (sRGB), without its straight part
_EDGE_FACTOR = 6.0
"""An edge is in focus where its gradient is so many times the median one, which noise makes."""
_LEAST_EDGE = 48.0
"""And so large at least: of the 1,020 that the Sobel operator gives at a full edge of 255 codes."""


@dataclass(frozen=True, eq=False)
class View:
    """One picture of the camera, in the shape of its frames, and what is known of it."""

    number: int
    codes: Codes
    layout: Layout
    facts: dict[str, Any]


@dataclass(frozen=True)
class Look:
    """How a browser shows a picture.

    Attributes:
        width, height: of its place on the screen, pixels
        centre: of the part that is shown at 100 %, shares of width and height; None: all of it
        clipping: paint what is saturated red, and what is too dark blue
        peaking: paint edges that are in focus
    """

    width: int
    height: int
    centre: tuple[float, float] | None = None
    clipping: bool = False
    peaking: bool = False


class Sight:
    """Keeps the last picture of the camera while a browser looks."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._view: View | None = None
        self._asked_s = -_LOOKS_S
        self._has_ended = False

    def show_frame(self, frame: Frame, controls: ExposureControls, metered: Metering) -> None:
        """Take a metering frame."""
        white, black = frame.white, frame.black
        levels = np.arange(white + 1, dtype=np.float64)
        light = np.clip((levels - black) / (white - black), 0.0, 1.0)
        table = (1.0 + 253.0 * light ** (1 / _DISPLAY_GAMMA)).astype(np.uint8)
        table[white:] = _SATURATED  # what is black here, longer exposures may show
        codes: Codes = table[np.minimum(frame.pixels, white)]
        # E = 1 saturates the shortest exposure that will be planned.
        seen = controls.levels.levels
        unit = metered.limit_s / frame.applied.time_s
        counts = np.bincount(np.minimum(frame.pixels, white).ravel()[:: _step(codes)])
        counts = counts[black:].astype(np.float64)
        E = np.concatenate(([seen[0] / 2], seen))[: counts.size] * unit
        self._show(
            codes,
            controls.layout,
            {
                "live": False,
                **_histogram(E, counts[: E.size]),
                "time_s": metered.limit_s,
                "clipped": float(counts[-1] / counts.sum()) if counts.size > seen.size else 0.0,
            },
        )

    def show_result(self, result: LiveResult, seen: Light, controls: ExposureControls) -> None:
        """Take a picture of the effective camera."""
        if not self.is_wanted:
            return
        from camctl.pictures.render import DARK, SATURATED

        def coded(table: Any) -> Codes:
            found: Codes = np.clip(table.code >> 8, 1, 254).astype(np.uint8)
            found[table.mask == DARK] = _TOO_DARK
            found[table.mask == SATURATED] = _SATURATED
            return found

        codes = result.through(coded, "studio").copy()
        low = float(np.log2(result.plan.desired.e_min))
        facts = {
            "live": True,
            **_histogram(seen.irradiance, seen.shares),
            "range_stops": [low, 0.0],
            "clipped": seen.clipped,
            "dark": seen.dark,
            "time_s": min(each.time_s for each in result.plan.settings),
        }
        self._show(codes, result.layout, facts)

    @property
    def is_wanted(self) -> bool:
        """Whether a browser looks."""
        return time.monotonic() - self._asked_s < _LOOKS_S

    def _show(self, codes: Codes, layout: Layout, facts: dict[str, Any]) -> None:
        with self._changed:
            number = 1 if self._view is None else self._view.number + 1
            self._view = View(number, codes, layout, facts)
            self._changed.notify_all()

    def wait(self, after: int) -> View | None:
        """Return the next picture that is not number `after`; None where there is none."""
        with self._changed:
            self._asked_s = time.monotonic()
            self._changed.wait_for(
                lambda: self._has_ended or (self._view is not None and self._view.number != after),
                _SILENCE_S,
            )
            return self._view

    def end(self) -> None:
        """Answer those who wait."""
        with self._changed:
            self._has_ended = True
            self._changed.notify_all()


def _step(codes: Codes) -> int:
    """Return of how many samples one is counted: a quarter of a million are enough."""
    return max(1, codes.size >> 18) | 1


def _histogram(E: NDArray[Any], counts: NDArray[Any]) -> dict[str, Any]:
    found = counts_in_stops(E, counts, SHOWN_STOPS)
    total = max(float(found.sum()), 1e-12)
    return {
        "histogram": (found / total).tolist(),
        "first_stop": float(SHOWN_STOPS[0]),
        "last_stop": float(SHOWN_STOPS[-1]),
    }


def rendered(view: View, look: Look) -> tuple[bytes, str, float]:
    """Return a picture file, its media type, and the focus value of what it shows."""
    codes = _cropped(view, look)
    picture = _colours(codes, view.layout)
    sharpness, lengths = _focus(picture)
    paint: list[tuple[NDArray[np.bool_], tuple[int, int, int]]] = []
    if look.clipping:
        paint.append(((picture == _SATURATED).any(axis=2), (255, 40, 40)))
        paint.append(((picture == _TOO_DARK).all(axis=2), (60, 90, 255)))
    if look.peaking:
        least = max(_LEAST_EDGE, _EDGE_FACTOR * float(np.median(lengths)))
        paint.append((lengths > least, (90, 255, 120)))
    for where, colour in paint:
        picture[where] = colour
    rows, columns = picture.shape[:2]
    scale = min(look.width / columns, look.height / rows)
    if scale < 1:
        size = max(1, round(columns * scale)), max(1, round(rows * scale))
        picture = np.asarray(reduced_by_area(picture, size), np.uint8)
    if opencv() is None:
        return png(picture), "image/png", sharpness
    return jpeg(picture, _QUALITY), "image/jpeg", sharpness


def _cropped(view: View, look: Look) -> Codes:
    """Return the samples that are shown, from an even place on."""
    if look.centre is None:
        return view.codes
    places = []
    for length, wanted, share in zip(
        view.codes.shape[:2], (look.height, look.width), look.centre[::-1], strict=True
    ):
        most = min(wanted, length) & ~1 or length
        first = round(share * length - most / 2) & ~1
        first = min(max(first, 0), (length - most) & ~1)
        places.append(slice(first, first + most))
    return view.codes[tuple(places)]


_BAYER = {Layout.RGGB: "BG", Layout.GRBG: "GB", Layout.GBRG: "GR", Layout.BGGR: "RG"}
"""OpenCV names a mosaic by the second and third sample of its second row."""


def _colours(codes: Codes, layout: Layout) -> Codes:
    """Return (rows, columns, 3), not shared with `codes`."""
    if layout is Layout.MONO:
        return np.repeat(codes[..., np.newaxis], 3, axis=2)
    if not layout.is_mosaic:
        return codes.copy()
    if (cv2 := opencv()) is not None and layout in _BAYER and min(codes.shape) > 2:
        code = getattr(cv2, f"COLOR_Bayer{_BAYER[layout]}2RGB")
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(codes), code), np.uint8)
    from camctl.livestream.display import rgb_of_cells

    return rgb_of_cells(codes, layout)


def _focus(picture: Codes) -> tuple[float, NDArray[np.float32]]:
    """Return the Tenengrad over brightness 0 to 1, and the length of the gradient of each pixel."""
    luma = picture.mean(axis=2, dtype=np.float32) if picture.shape[2] > 1 else picture[..., 0]
    lengths = gradient(np.asarray(luma, np.float32))
    return float(np.mean(np.square(lengths / 255.0))), lengths
