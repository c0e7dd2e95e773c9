"""Recorded streams of real cameras, as data: which frames are lost, and when the others arrive."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, NamedTuple, Self

from pydantic import Field, model_validator

from camctl.errors import unknown_name
from camctl.sim.data_files import FileModel, NotNegative, Positive, built_in_files, read_text

_Number = Annotated[int, Field(ge=0)]


class Arrival(NamedTuple):
    """When a frame arrives.

    Attributes:
        stamped: time that it states after the end of its exposure, frame intervals
        arrived: its arrival likewise
    """

    stamped: float
    arrived: float


class RecordedStream(FileModel):
    """The frames of a real stream, which begin again after the last one.

    Attributes:
        about: what it shows
        source: where it was published
        interval_ms: from frame to frame
        is_numbered: whether frames state their numbers
        numbers: of the frames that arrived; others were lost
        times_ms: that these stated
        delays_ms: from that time to their arrival; none: they arrived then
    """

    about: str
    source: str
    interval_ms: Positive
    is_numbered: bool
    numbers: tuple[_Number, ...] = Field(min_length=2)
    times_ms: tuple[NotNegative, ...]
    delays_ms: tuple[NotNegative, ...] = ()

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        count = len(self.numbers)
        if len(self.times_ms) != count or len(self.delays_ms) not in (0, count):
            raise ValueError("there must be as many times as numbers, and as many delays or none")
        if list(self.numbers) != sorted(set(self.numbers)):
            raise ValueError("numbers must ascend")
        return self

    def arrival(self, number: int) -> Arrival | None:
        """Return when a frame arrives; None where it is lost."""
        return self._arrivals.get(number % (self.numbers[-1] + 1))

    @cached_property
    def _arrivals(self) -> dict[int, Arrival]:
        """By number; the frame that is the least late has the time of the end of its exposure."""
        delays_ms = self.delays_ms or (0.0,) * len(self.numbers)
        stamped = [
            time_ms / self.interval_ms - number
            for time_ms, number in zip(self.times_ms, self.numbers, strict=True)
        ]
        arrived = [
            late + delay_ms / self.interval_ms
            for late, delay_ms in zip(stamped, delays_ms, strict=True)
        ]
        first = min(stamped)
        return {
            number: Arrival(late - first, then - first)
            for number, late, then in zip(self.numbers, stamped, arrived, strict=True)
        }


def load_stream(name: str) -> RecordedStream:
    """Return a stream that comes with the program.

    Raises:
        UsageError: there is none of that name
    """
    built_in = built_in_files("streams")
    if name not in built_in:
        raise unknown_name("stream", name, built_in)
    return read_text(RecordedStream, built_in[name], source=f"stream {name}")
