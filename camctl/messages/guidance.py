"""What a person does before a calibration, in the words of all front ends."""

from __future__ import annotations

from typing import Final

STILL_SCENE: Final = (
    "Put the camera on a tripod before a scene that does not move, with dark and bright parts and "
    "many shades between: a room with a window, a desk under a lamp.",
    "Its light must be steady: daylight without moving clouds, or a lamp that does not flicker.",
    "Switch automatic exposure, gain, white balance and focus off. It takes a few minutes.",
)
COVERED: Final = (
    "Cover the lens, with its cap or a dark cloth. What the pictures then show is the dark signal "
    "and hot pixels."
)
