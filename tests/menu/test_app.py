"""The loop: keys in, work on a thread, screens out."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panel_fakes import COSTS, FakeJob, ScriptedPanel, plan_of

from camctl.captures.request import CapturePlan
from camctl.controls import ExposureSetting
from camctl.errors import CameraDisconnectedError, CameraNotFoundError, UsageError
from menu.app import run
from menu.model import RANGES, RESPONSES, Model, State
from menu.ports import Choice, Cost, Highlight, Key
from menu.screens import screen
from tests.menu.test_screens import settings_on

Script = list[tuple[str, Key | Callable[[], object]]]

TO_REVIEW: Script = [
    ("Desired", Key.ENTER),
    ("Dynamic", Key.ENTER),
    ("Exposures", Key.ENTER),
]
QUIT_PAGE: list[Key] = [Key.RIGHT, Key.RIGHT, Key.ENTER]


def leave(title: str) -> Script:
    """The keys from a page to its last action, which is to quit."""
    return [(title, key) for key in QUIT_PAGE]


def gone() -> None:
    raise CameraDisconnectedError("the camera went away", hint="plug it in again")


def broken() -> None:
    raise ZeroDivisionError("no such thing")


def test_from_response_to_result() -> None:
    job = FakeJob()
    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), *leave("Done")])
    summary = run(panel, job)
    assert summary is not None
    assert summary.folder == "captures/x"
    assert job.planned == [Choice("log", 1000.0, 3)]
    assert not panel.open
    assert any("390 levels" in lines[1] for lines in panel.seen)


def test_leaving_at_once_gives_nothing() -> None:
    job = FakeJob()
    assert run(ScriptedPanel([("Desired", Key.EXIT)]), job) is None
    assert job.predicted == []


def test_again_meters_again() -> None:
    job = FakeJob()
    script = [*TO_REVIEW, ("Review", Key.ENTER), ("Done", Key.ENTER), ("Review", Key.ENTER)]
    run(ScriptedPanel([*script, *leave("Done")]), job)
    assert len(job.planned) == len(job.shot) == 2


class RandomPlans(FakeJob):
    """Plans that have nothing to do with the choice: only the plan itself can be on the screen."""

    def __init__(self, plans: Sequence[CapturePlan]) -> None:
        super().__init__()
        self.plans = list(plans)

    def plan(self, choice: Choice) -> CapturePlan:
        super().plan(choice)
        return self.plans.pop(0)


@settings(max_examples=25)
@given(
    st.integers(0, len(RESPONSES) - 1),
    st.integers(0, len(RANGES) - 1),
    st.integers(1, len(COSTS)),
    st.lists(st.lists(st.floats(1e-5, 100.0), min_size=1, max_size=6), min_size=2, max_size=2),
    st.tuples(st.integers(20, 60), st.integers(4, 16)),
)
def test_what_is_on_the_screen_is_what_is_shot(
    response: int,
    dynamic_range: int,
    count: int,
    times: list[list[float]],
    size: tuple[int, int],
) -> None:
    plans = [plan_of([ExposureSetting(t) for t in sorted(group)]) for group in times]
    job = RandomPlans(plans)
    here = Model()
    steps = [
        ("Desired", response - here.response),
        ("Dynamic", dynamic_range - here.range),
        ("Exposures", count - here.count),
    ]
    script: Script = []
    for title, moves in steps:
        script += [(title, Key.DOWN if moves > 0 else Key.UP)] * abs(moves)
        script.append((title, Key.ENTER))
    # The first plan is looked at and left; the second is shot.
    script += [("Review", Key.EXIT), ("Exposures", Key.ENTER)]
    panel = ScriptedPanel(script, size)
    read: list[tuple[str, ...]] = []
    panel.script += [("Review", lambda: read.append(panel.lines)), ("Review", Key.ENTER)]
    panel.script += leave("Done")
    run(panel, job)
    wanted = Choice(RESPONSES[response].name, RANGES[dynamic_range].value, count)
    assert job.planned == [wanted, wanted]
    assert len(job.shot) == 1
    assert job.shot[0] is plans[1]
    shot = Model(State.REVIEW, response, dynamic_range, count, plan=job.shot[0])
    assert read == [screen(shot, *size).lines]
    assert [setting.time_s for setting in settings_on(shot, *size)] == pytest.approx(
        [setting.time_s for setting in plans[1].settings], rel=1e-6, abs=0
    )


def test_a_page_scrolls_back_at_the_first_press() -> None:
    panel = ScriptedPanel(TO_REVIEW)
    before: list[tuple[str, ...]] = []
    panel.script += [("Review", Key.DOWN)] * 20
    panel.script += [("Review", lambda: before.append(panel.lines)), ("Review", Key.UP)]
    panel.script += [("Review", lambda: before.append(panel.lines)), *leave("Review")]
    run(panel, FakeJob())
    assert before[0][0].endswith("^ ")
    assert before[1][0].endswith("^v")


def test_cancel_while_shooting_keeps_and_offers_to_go_on() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [
        *TO_REVIEW,
        ("Review", Key.ENTER),
        ("Shooting", lambda: job.frame_started.wait(5)),
        ("Shooting", Key.EXIT),
        ("Cancelled", lambda: job.frame_may_end.set()),
        ("Cancelled", Key.ENTER),
        *leave("Done"),
    ]
    panel = ScriptedPanel(script, (60, 8))
    assert run(panel, job) is not None
    assert any("stopped after 0 frames" in "".join(lines) for lines in panel.seen)
    assert job.shot[0] is job.shot[1]


def test_enter_does_not_cancel() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [*TO_REVIEW, ("Review", Key.ENTER)]
    script += [("Shooting", key) for key in Key if key is not Key.EXIT]
    script += [("Shooting", lambda: job.frame_may_end.set()), *leave("Done")]
    assert run(ScriptedPanel(script), job) is not None


@pytest.mark.parametrize(
    ("where", "title"), [("predict", "No costs"), ("plan", "No plan"), ("shoot", "Failed")]
)
def test_an_error_is_one_line_with_a_way_on(where: str, title: str) -> None:
    job = FakeJob()
    job.before[where] = gone
    asked: Script = [*TO_REVIEW, ("Review", Key.ENTER)]
    before = asked[: {"predict": 2, "plan": 3, "shoot": 4}[where]]
    after = asked[len(before) :]
    script: Script = [
        *before,
        (title, Key.ENTER),  # retry: it is still gone
        (title, lambda: job.before.clear()),
        (title, Key.ENTER),
        *after,
        *leave("Done"),
    ]
    panel = ScriptedPanel(script, (60, 5))
    assert run(panel, job) is not None
    assert any("the camera went away; plug it in again" in lines[1] for lines in panel.seen)


def test_back_and_quit_from_an_error() -> None:
    job = FakeJob()
    job.before["plan"] = gone
    script: Script = [*TO_REVIEW, ("No plan", Key.RIGHT), ("No plan", Key.ENTER)]
    script += [("Exposures", Key.ENTER), *leave("No plan")]
    assert run(ScriptedPanel(script), job) is None
    assert len(job.planned) == 2


def test_a_fault_of_the_program_is_shown_and_then_raised() -> None:
    job = FakeJob()
    job.before["shoot"] = broken
    script: Script = [*TO_REVIEW, ("Review", Key.ENTER), *leave("Failed")]
    panel = ScriptedPanel(script, (60, 5))
    with pytest.raises(ZeroDivisionError, match="no such thing"):
        run(panel, job)
    assert not panel.open
    assert any("ZeroDivisionError: no such thing" in lines[1] for lines in panel.seen)


def test_a_fault_that_was_overcome_is_logged_when_the_panel_is_closed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    job = FakeJob()
    job.before["shoot"] = broken
    panel = ScriptedPanel([])

    def repaired() -> None:
        job.before.clear()
        assert not caplog.records

    panel.script += [*TO_REVIEW, ("Review", Key.ENTER), ("Failed", repaired)]
    panel.script += [("Failed", Key.ENTER), *leave("Done")]
    with caplog.at_level(logging.WARNING):
        assert run(panel, job) is not None
    assert "ZeroDivisionError" in caplog.text


def test_keys_typed_ahead_do_not_shoot_what_nobody_has_seen() -> None:
    job = FakeJob()
    panel = ScriptedPanel([])

    def impatient() -> None:
        panel.typed_ahead += [Key.ENTER] * 20

    job.before["plan"] = impatient
    panel.script += [*TO_REVIEW, *leave("Review")]
    assert run(panel, job) is None
    assert job.shot == []


def test_an_interrupt_cancels_the_shot_and_closes_the_panel() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def control_c() -> None:
        assert job.frame_started.wait(5)
        raise KeyboardInterrupt

    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), ("Shooting", control_c)])
    with pytest.raises(KeyboardInterrupt):
        run(panel, job)
    assert not panel.open
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


def test_a_panel_that_goes_away_cancels_the_shot() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def unplugged() -> None:
        assert job.frame_started.wait(5)
        raise CameraNotFoundError("the panel went away")

    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), ("Shooting", unplugged)])
    with pytest.raises(CameraNotFoundError):
        run(panel, job)
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


def test_leaving_does_not_wait_for_a_prediction() -> None:
    job = FakeJob()
    hold, begun = threading.Event(), threading.Event()
    job.before["predict"] = lambda: (begun.set(), hold.wait(20))
    script: Script = [
        ("Desired", Key.ENTER),
        ("Dynamic", Key.ENTER),
        ("Working", lambda: begun.wait(5)),
        ("Working", Key.EXIT),
        ("Dynamic", Key.EXIT),
        ("Desired", Key.EXIT),
    ]
    began = time.monotonic()
    assert run(ScriptedPanel(script), job) is None
    assert time.monotonic() - began < 5
    hold.set()


def test_questions_taken_back_are_not_worked_on() -> None:
    job = FakeJob()
    hold = threading.Event()
    job.before["predict"] = lambda: hold.wait(20)

    def begun() -> None:
        while not job.predicted:
            time.sleep(0.001)

    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER), ("Working", begun)]
    script += [("Working", Key.EXIT)]
    for _ in range(3):
        script += [("Dynamic", Key.ENTER), ("Working", Key.EXIT)]
    script += [("Dynamic", Key.UP), ("Dynamic", Key.ENTER), ("Working", hold.set)]
    script += [("Exposures", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    run(ScriptedPanel(script), job)
    assert job.predicted == [("log", 1000.0), ("log", 16000.0)]


class SlowCosts(FakeJob):
    """Finds one number of exposures after the other, each when it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[int] = []
        self.may_find = threading.Semaphore(0)

    def predict(self, response: str, dynamic_range: float) -> Iterator[Cost]:
        self.predicted.append((response, dynamic_range))
        for cost in COSTS:
            self.may_find.acquire(timeout=20)
            self.found.append(cost.count)
            yield cost


def test_costs_that_take_time_show_how_far_they_are() -> None:
    job = SlowCosts()
    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER)]
    script += [("Working", job.may_find.release)] * 2
    script += [("2 counts done", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    assert run(ScriptedPanel(script), job) is None
    assert job.found == [1, 2]


def test_costs_that_nobody_waits_for_are_left() -> None:
    job = SlowCosts()
    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER)]
    script += [("Working", job.may_find.release), ("1 counts done", Key.EXIT)]
    script += [("Dynamic", Key.UP), ("Dynamic", Key.ENTER)]
    script += [("Working", job.may_find.release)] * 7
    script += [("Exposures", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    run(ScriptedPanel(script), job)
    assert job.found == [1, 2, 1, 2, 3, 4, 5, 6]


def test_a_panel_that_is_too_small_is_refused() -> None:
    class Tiny(ScriptedPanel):
        def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
            raise AssertionError("nothing fits")

    with pytest.raises(UsageError, match="16 x 2 characters; the menu needs 20 x 4"):
        run(Tiny([], (16, 2)), FakeJob())
