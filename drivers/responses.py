"""The responses that a person can name for the files or frames of a camera."""

from __future__ import annotations

from camctl.errors import UsageError, unknown_name
from camctl.exposure.response import RealResponse
from camctl.exposure.standard import STANDARDS, standard_response

#: What stands after -O response=.
RESPONSES = (*STANDARDS[:-1], "power:GAMMA")


def named_response(word: str, bits: int, levels: int) -> RealResponse | None:
    """Return the response that a word names; None: linear.

    Args:
        word: a name in `STANDARDS`, or power:GAMMA; power alone is power:2.2
        bits: a sample
        levels: white minus black

    Raises:
        UsageError: it is none of these, or an impossible gamma
    """
    name, _, gamma = word.partition(":")
    if name not in STANDARDS or (gamma and name != "power"):
        raise unknown_name("camera response", word, RESPONSES)
    if name == "linear":
        return None
    try:
        exponent = float(gamma) if gamma else 2.2
    except ValueError:
        raise UsageError(f"a response of '{word}'", hint="write it like power:2.2") from None
    return standard_response(name, bits, levels=levels, gamma=exponent)
