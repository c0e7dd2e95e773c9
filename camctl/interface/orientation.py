"""How the pixels of a picture lie: the eight orientations of TIFF and EXIF (tag 274)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What `Frame.details` have of it.  Their pixels are as the sensor has them, since a camera that
#: looks down may state any turn from frame to frame.
_QUARTER_TURNS, _MIRRORED = "quarter_turns", "mirrored"


@dataclass(frozen=True)
class Orientation:
    """What makes a picture upright.

    Attributes:
        quarter_turns: by which it must be turned anticlockwise, 0 to 3
        mirrored: whether left and right must be exchanged before that
    """

    quarter_turns: int = 0
    mirrored: bool = False

    @classmethod
    def of_tag(cls, value: object) -> Orientation:
        """Return the orientation of a value of the tag; upright where it is invalid."""
        return next((each for tag, each in _BY_TAG.items() if tag == value), cls())

    @classmethod
    def of_details(cls, details: Mapping[str, Any]) -> Orientation:
        """Return the orientation in `Frame.details`; upright where they have none."""
        turns = details.get(_QUARTER_TURNS)
        return cls(turns % 4 if isinstance(turns, int) else 0, details.get(_MIRRORED) is True)

    @property
    def details(self) -> dict[str, int]:
        """It as `Frame.details` have it."""
        turns = {_QUARTER_TURNS: self.quarter_turns} if self.quarter_turns else {}
        return turns | ({_MIRRORED: True} if self.mirrored else {})

    @property
    def tag(self) -> int:
        """The value of the tag."""
        return next(tag for tag, each in _BY_TAG.items() if each == self)

    @property
    def is_upright(self) -> bool:
        """Whether nothing needs to be changed."""
        return self == UPRIGHT

    def upright(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Return a view of pixels, (rows, columns) or more, that is upright."""
        view: NDArray[Any] = np.rot90(
            pixels[:, ::-1] if self.mirrored else pixels, self.quarter_turns
        )
        return view

    def lying(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Return a view of upright pixels as they lay before."""
        view: NDArray[Any] = np.rot90(pixels, -self.quarter_turns)
        return view[:, ::-1] if self.mirrored else view


UPRIGHT = Orientation()

_BY_TAG = {
    1: UPRIGHT,
    2: Orientation(0, mirrored=True),
    3: Orientation(2),
    4: Orientation(2, mirrored=True),
    5: Orientation(1, mirrored=True),
    6: Orientation(3),
    7: Orientation(3, mirrored=True),
    8: Orientation(1),
}
