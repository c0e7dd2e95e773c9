"""How much of a picture, and how bright, it takes to measure anything in it."""

FEW = 0.01
"""Share of samples that is few, be they lit, black or saturated: reflections and lamps have it."""

DIM = 0.08
"""Share of full scale below which errors of the black level and of the dark end of a response count
more than light: an error of one level of 256 is 5 % there."""

DARK = 0.02
"""Share of full scale below which noise and clipping at black distort a mean: 5 levels of 256."""

MOST_MOVED = 0.25
"""Share of a picture from which the camera or the scene moved, and not a thing in it.  Also the
relative change of a patch from which it shows another thing: bands of a lamp change less."""

LEAST_PATCHES = 64
"""Patches from which a figure is measured: a median of so many has an error of 16 % of their
scatter, sqrt(pi / 2 / 64)."""

OUTLIER = 2.0
"""Errors from which observations lose weight in a robust fit (Huber), standard deviations."""

ROUNDS = 10
"""Rounds of a fit by reweighted least squares at most: 20 give the same figures to 4e-7."""
