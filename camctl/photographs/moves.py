"""How photographs taken from the hand are moved onto each other.

A shift by whole pixels (cells of a mosaic) leaves every sample as it is.  A homography interpolates
samples: it also mends what turned, came nearer or was tilted, and softens what is fine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.alignment import brightness_matched, displacement
from camctl.findings import Finding
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.photographs.alignment import ALIGNABLE, Chain, Sight, grey_copy, usual_place
from camctl.system.picture_operations import required_opencv

#: Longest side of the grey copies in which moves are measured, pixels: of 24 megapixels one in the
#: copy is 2.6, and a displacement is known to a tenth of that.
_SIDE = 2304
#: The same for a homography, whose fit takes 1 s a megapixel.
_HOMOGRAPHY_SIDE = 1280
#: Steps of the fit of a homography at most, and the change of the correlation that ends it.
_STEPS, _SMALL_STEP = 60, 1e-5
#: Standard deviation of the blur before it, as a kernel's width, pixels.
_BLUR = 5
#: Points along each side at which a picture is asked where all photographs show it.
_POINTS = 65

_Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Move:
    """Where a photograph has what the others have at a place.

    Attributes:
        matrix: (3, 3), from a place (column, row, 1) of the result to the photograph's, pixels
        is_whole: it is a shift by whole pixels
    """

    matrix: _Matrix
    is_whole: bool

    @classmethod
    def whole(cls, columns: float, rows: float, step: int) -> Move:
        """Return a shift by the nearest multiples of `step`."""
        matrix = np.eye(3)
        matrix[:2, 2] = step * np.rint(np.array((columns, rows)) / step)
        return cls(matrix, True)

    @property
    def shift(self) -> tuple[int, int]:
        """Columns and rows of a shift."""
        columns, rows = self.matrix[:2, 2].astype(int).tolist()
        return columns, rows

    def in_whole(self, rows: slice, columns: slice) -> Move:
        """Return the move of whole photographs, of which this is the one of a part."""
        to_part = np.eye(3)
        to_part[:2, 2] = -(columns.start or 0), -(rows.start or 0)
        return Move(np.linalg.inv(to_part) @ self.matrix @ to_part, self.is_whole)

    def applied(self, pixels: Pixels, layout: Layout, white: int) -> Pixels:
        """Return a photograph in the place of the others; what it does not show is its border."""
        step = 2 if layout.is_mosaic else 1
        if self.is_whole:
            columns, rows = self.shift
            indices = [
                _clipped(np.arange(length) + by, length, step)
                for length, by in zip(pixels.shape[:2], (rows, columns), strict=True)
            ]
            moved: Pixels = pixels[np.ix_(*indices)]
            return moved
        found = np.empty_like(pixels)
        for row in range(step):
            for column in range(step):
                part = slice(row, None, step), slice(column, None, step)
                plane = np.array(((step, 0, column), (0, step, row), (0, 0, 1)), float)
                matrix = np.linalg.inv(plane) @ self.matrix @ plane
                found[part] = _warped(pixels[part], matrix, white)
        return found


def _clipped(places: NDArray[np.intp], length: int, step: int) -> NDArray[np.intp]:
    """Return places inside a side; those beyond its ends become the last ones of their colour."""
    low = np.where(places < 0, places % step, places)
    last = length - 1 - (length - 1 - low) % step
    return np.asarray(np.minimum(low, last))


def _warped(pixels: Pixels, matrix: _Matrix, white: int) -> Pixels:
    """Return samples at moved places; one that a saturated sample is in is saturated."""
    cv2 = required_opencv("aligning photographs")
    size = pixels.shape[1::-1]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(
        np.ascontiguousarray(pixels), matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    is_full = (pixels >= white).astype(np.uint8) * np.uint8(255)
    if is_full.any():
        full = cv2.warpPerspective(is_full, matrix, size, flags=flags)
        moved[full > 0] = white
    result: Pixels = moved
    return result


def moves_of(
    sights: Sequence[Sight],
    chains: Sequence[Chain],
    pixels: Callable[[int], Pixels],
    white: int,
    layout: Layout,
    *,
    full: bool,
) -> dict[int, Move]:
    """Return by position how photographs are moved so that all lie as most do.

    Args:
        sights: of the photographs
        chains: of them; those of another one than the longest are not moved
        pixels: returns a photograph
        white: white level, DN
        layout: of the photographs
        full: by homographies, and not by whole pixels
    """
    chain = max(chains, key=len)
    _, usual = usual_place(sights, chain)
    order = [k for k, _ in chain]
    side = _HOMOGRAPHY_SIDE if full else _SIDE
    copies = {k: grey_copy(pixels(k), white, side) for k in order}
    scale = copies[order[0]][1]
    ratio = sights[order[0]].scale / scale
    coarse = dict(chain)
    matrices = {order[0]: np.eye(3)}
    for one, other in pairwise(order):
        greys = copies[one][0], copies[other][0]
        found = displacement(*greys)
        if found is None or np.abs(found[:2] - ratio * (coarse[other] - coarse[one])[:2]).max() > (
            max(3.0, 2 * ratio)
        ):
            found = (coarse[other] - coarse[one]) * (ratio, ratio, 1, 1)
        step = _similarity(found, greys[0].shape, full=full)
        if full:
            step = _homography(step, *greys)
        matrices[other] = step @ matrices[one]
    # As most lie: the one of them in the middle of the brightness stays as it is.
    reference = [k for k in order if k in usual][len(usual) // 2]
    back = np.linalg.inv(matrices[reference])
    whole = np.array(((scale, 0, (scale - 1) / 2), (0, scale, (scale - 1) / 2), (0, 0, 1)))
    moves = {}
    step_size = 2 if layout.is_mosaic else 1
    for k in order:
        matrix = whole @ matrices[k] @ back @ np.linalg.inv(whole)
        matrix /= matrix[2, 2]
        rows, columns = pixels(k).shape[:2]
        centre = np.array(((columns - 1) / 2, (rows - 1) / 2))
        middle = matrix @ (*centre, 1)
        by = middle[:2] / middle[2] - centre
        # So far no hand moves: a thing that moved may be all that can be compared.
        if k == reference or np.abs(by).max() > ALIGNABLE * max(rows, columns):
            continue
        move = Move(matrix, False) if full else Move.whole(by[0], by[1], step_size)
        if full or any(move.shift):
            moves[k] = move
    return moves


def _similarity(found: _Matrix, shape: tuple[int, ...], *, full: bool) -> _Matrix:
    """Return the matrix of a displacement about the centre of a copy."""
    columns, rows, turn, growth = found if full else (*found[:2], 0.0, 0.0)
    x, y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    centre = np.array(((1, 0, x), (0, 1, y), (0, 0, 1)))
    about = np.array(((1 + growth, -turn, columns), (turn, 1 + growth, rows), (0, 0, 1)))
    return np.asarray(centre @ about @ np.linalg.inv(centre))


def _homography(start: _Matrix, short: NDArray[np.float32], long: NDArray[np.float32]) -> _Matrix:
    """Return the homography from the shorter exposure to the longer one that fits best.

    Evangelidis and Psarakis, Parametric Image Alignment Using Enhanced Correlation Coefficient
    Maximization, 2008, from `start` on, which is returned where it does not become better.
    """
    cv2: ModuleType = required_opencv("aligning photographs")
    matched, usable = brightness_matched(short, long)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _SMALL_STEP)
    matrix = start.astype(np.float32)
    mask = usable.astype(np.uint8)
    try:
        _, found = cv2.findTransformECC(
            short, matched, matrix.copy(), cv2.MOTION_HOMOGRAPHY, criteria, mask, _BLUR
        )
    except cv2.error:  # it does not converge
        return start
    if not np.isfinite(found).all():
        return start
    return np.asarray(found, np.float64)


def overlap(moves: Sequence[Move], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return (rows, columns) of a rectangle that every moved photograph shows."""
    rows, columns = shape[:2]
    if all(each.is_whole for each in moves):
        shifts = [(0, 0), *(each.shift for each in moves)]
        across, down = ([shift[axis] for shift in shifts] for axis in (0, 1))
        return (
            slice(max(0, -min(down)), rows - max(0, *down)),
            slice(max(0, -min(across)), columns - max(0, *across)),
        )
    from camctl.photographs.valid_area import largest_rectangle

    x, y = np.meshgrid(np.linspace(0, columns - 1, _POINTS), np.linspace(0, rows - 1, _POINTS))
    places = np.stack((x, y, np.ones_like(x)), axis=-1)
    shown = np.ones(x.shape, np.bool_)
    for each in moves:
        moved = places @ each.matrix.T
        moved = moved[..., :2] / moved[..., 2:]
        shown &= ((moved >= 0) & (moved <= (columns - 1, rows - 1))).all(axis=-1)
    inner = largest_rectangle(shown)
    ends = []
    for part, length in zip(inner, (rows, columns), strict=True):
        step = (length - 1) / (_POINTS - 1)
        ends.append(slice(int(np.ceil(part.start * step)), int((part.stop - 1) * step) + 1))
    return ends[0], ends[1]


def aligned_finding(moves: dict[int, Move], count: int, shape: tuple[int, ...]) -> Finding:
    """Return that photographs were moved, and by how much at most."""
    rows, columns = shape[:2]
    corners = np.array(
        ((0, 0, 1), (columns - 1, 0, 1), (0, rows - 1, 1), (columns - 1, rows - 1, 1))
    )
    most = 0.0
    for each in moves.values():
        moved = corners @ each.matrix.T
        distance = moved[:, :2] / moved[:, 2:] - corners[:, :2]
        most = max(most, float(np.hypot(*distance.T).max()))
    is_whole = all(each.is_whole for each in moves.values())
    return Finding(
        code="aligned",
        frames=tuple(sorted(moves)),
        value=most,
        details={"count": len(moves), "of": count, "by": "shift" if is_whole else "homography"},
        remedies={"align": "none"},
    )
