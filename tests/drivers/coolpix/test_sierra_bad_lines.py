"""What a bad line makes of the answers of a Sierra camera ends in time, with data or an error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from hypothesis import given, settings
from hypothesis import strategies as st
from sierra_model import PICTURE, Camera, session

from camctl.drivers.coolpix.sierra.packets import Action, Register
from camctl.errors import CameraError

Act = TypeVar("Act")


Damage = tuple[str, bytes]


@st.composite
def damages(draw: st.DrawFn) -> list[Damage]:
    """What a bad line does to one answer after another."""
    kinds = st.sampled_from(["keep", "drop", "cut", "flip", "twice", "noise", "before", "after"])
    return draw(st.lists(st.tuples(kinds, st.binary(min_size=1, max_size=40)), max_size=12))


def damaging(steps: Sequence[Damage]) -> Callable[[bytes], bytes]:
    """Return a `Camera.transmit` that does these damages in turn, and then none."""
    left = iter(steps)

    def transmit(answer: bytes) -> bytes:
        kind, noise = next(left, ("keep", b""))
        if not answer or kind == "keep":
            return answer
        at = noise[0] % len(answer)
        return {
            "drop": b"",
            "cut": answer[:at],
            "flip": answer[:at] + bytes((answer[at] ^ (noise[0] | 1),)) + answer[at + 1 :],
            "twice": answer * 2,
            "noise": noise,
            "before": noise + answer,
            "after": answer + noise,
        }[kind]

    return transmit


def outcome(act: Callable[[], Act]) -> tuple[Act | None, CameraError | None]:
    """Return what `act` returns, or its typed error, which is one line."""
    try:
        return act(), None
    except CameraError as error:
        caught = error
    assert "\n" not in str(caught)
    return None, caught


class TestBadLines:
    @given(damages())
    def test_data_is_correct_or_a_typed_error(self, steps: list[Damage]) -> None:
        camera = Camera(PICTURE)
        sierra, clock = session(camera), camera.clock
        camera.transmit = damaging(steps)
        before = clock.now()
        data, error = outcome(lambda: sierra.read(Register.PICTURE_DATA, len(PICTURE), picture=1))
        assert error is None or error.hint
        assert data is None or len(data) <= len(PICTURE)
        if data is not None and all(kind in ("keep", "drop", "cut", "twice") for kind, _ in steps):
            assert data == PICTURE
        assert clock.now() - before < 200
        assert camera.sent < 300_000

    @settings(max_examples=100)
    @given(st.binary(min_size=1, max_size=3000))
    def test_a_device_that_always_answers_the_same_is_given_up(self, answer: bytes) -> None:
        camera = Camera()
        sierra, clock = session(camera), camera.clock
        camera.receive = lambda data: camera.send(answer)
        before = clock.now()
        acts: list[Callable[[], object]] = [
            lambda: sierra.get(Register.PICTURES),
            lambda: sierra.set(Register.SHUTTER_US, 1),
            lambda: sierra.read(Register.PICTURE_DATA, 1 << 16, picture=1),
            lambda: sierra.act(Action.TAKE_PICTURE),
            sierra.open,
        ]
        for act in acts:
            outcome(act)
        assert clock.now() - before < 300
        assert camera.sent < 10_000_000
