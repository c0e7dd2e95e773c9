"""The option `response` of drivers whose frames do not say what their samples stand for."""

from __future__ import annotations

from typing import Annotated

from pydantic import field_validator

from camctl.interface.backends import BackendOptions, LowerCase
from camctl.interface.controls import ResponseOrigin
from camctl.model.response.camera import named_response


class ResponseOptions(BackendOptions):
    """Options of a camera whose response the user may state.

    Attributes:
        response: linear, srgb, rec709, power:GAMMA, or power (gamma 2.2)
    """

    response: Annotated[str, LowerCase] = "srgb"

    @field_validator("response")
    @classmethod
    def _is_a_response(cls, word: str) -> str:
        named_response(word, 8, 255)
        return word

    @property
    def response_origin(self) -> ResponseOrigin:
        """Stated where the user gave a response; else the default is only assumed."""
        is_given = "response" in self.model_fields_set
        return ResponseOrigin.STATED if is_given else ResponseOrigin.ASSUMED
