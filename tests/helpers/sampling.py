"""Cases of a test of which some run by default, and the others with the slow tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def some(cases: Iterable[Any], every: int, first: int = 0) -> list[Any]:
    """Return parameters of which those from `first` on, one in `every`, are not marked slow.

    A tuple has the values of several arguments; anything else is the value of one.
    """
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=() if k % every == first else pytest.mark.slow,
        )
        for k, case in enumerate(cases)
    ]
