"""The base of what is kept in a profile."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Values that do not change, and no unknown ones: anybody may have written the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
