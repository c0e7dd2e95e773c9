"""The menu's loop with a scripted panel and a job without a camera."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panel_fakes import COSTS, FakeJob, Script, ScriptedPanel, plan_of

from camctl.captures.request import CapturePlan
from camctl.controls import ExposureSetting
from camctl.errors import CameraDisconnectedError, CameraNotFoundError, UsageError
from menu.app import run
from menu.model import RANGES, RESPONSES, Model, State
from menu.ports import Choice, Cost, Highlight, Key
from menu.screens import screen
from tests.menu.test_screens import settings_on

TO_REVIEW: Script = [
    ("Desired", Key.ENTER),
    ("Dynamic", Key.ENTER),
    ("Exposures", Key.ENTER),
]
QUIT_PAGE: list[Key] = [Key.RIGHT, Key.RIGHT, Key.ENTER]


def quit_from(title: str) -> Script:
    """Return the keys from a page to its last action, which is to quit."""
    return [(title, key) for key in QUIT_PAGE]


def disconnect() -> None:
    raise CameraDisconnectedError("the camera was disconnected", hint="connect it again")


def fail_internally() -> None:
    raise ZeroDivisionError("division by zero")


def test_menu_leads_from_response_to_result() -> None:
    job = FakeJob()
    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), *quit_from("Done")])
    summary = run(panel, job)
    assert summary is not None
    assert summary.folder == "captures/x"
    assert job.planned == [Choice("log", 1000.0, 3)]
    assert not panel.open
    assert any("390 lv, 392 planned" in lines[1] for lines in panel.screens)


def test_quitting_at_once_returns_no_summary() -> None:
    job = FakeJob()
    assert run(ScriptedPanel([("Desired", Key.EXIT)]), job) is None
    assert job.predicted == []


def test_again_plans_again() -> None:
    job = FakeJob()
    script = [*TO_REVIEW, ("Review", Key.ENTER), ("Done", Key.ENTER), ("Review", Key.ENTER)]
    run(ScriptedPanel([*script, *quit_from("Done")]), job)
    assert len(job.planned) == len(job.shot) == 2


class GivenPlans(FakeJob):
    """Returns given plans, whatever the choice, so that the screen can only show the plan."""

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
def test_settings_on_the_screen_are_the_settings_shot(
    response: int,
    dynamic_range: int,
    count: int,
    times: list[list[float]],
    size: tuple[int, int],
) -> None:
    plans = [plan_of([ExposureSetting(t) for t in sorted(group)]) for group in times]
    job = GivenPlans(plans)
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
    # The first plan is reviewed and left; the second is shot.
    script += [("Review", Key.EXIT), ("Exposures", Key.ENTER)]
    panel = ScriptedPanel(script, size)
    read: list[tuple[str, ...]] = []
    panel.script += [("Review", lambda: read.append(panel.lines)), ("Review", Key.ENTER)]
    panel.script += quit_from("Done")
    run(panel, job)
    choice = Choice(RESPONSES[response].name, RANGES[dynamic_range].value, count)
    assert job.planned == [choice, choice]
    assert len(job.shot) == 1
    assert job.shot[0] is plans[1]
    shot = Model(State.REVIEW, response, dynamic_range, count, plan=job.shot[0])
    assert read == [screen(shot, *size).lines]
    assert [setting.time_s for setting in settings_on(shot, *size)] == pytest.approx(
        [setting.time_s for setting in plans[1].settings], rel=1e-6, abs=0
    )


def test_page_scrolls_back_at_the_first_press_of_up() -> None:
    panel = ScriptedPanel(TO_REVIEW)
    before: list[tuple[str, ...]] = []
    panel.script += [("Review", Key.DOWN)] * 20
    panel.script += [("Review", lambda: before.append(panel.lines)), ("Review", Key.UP)]
    panel.script += [("Review", lambda: before.append(panel.lines)), *quit_from("Review")]
    run(panel, FakeJob())
    assert before[0][0].endswith("^ ")
    assert before[1][0].endswith("^v")


def test_cancelled_capture_can_be_retried() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [
        *TO_REVIEW,
        ("Review", Key.ENTER),
        ("Shooting", job.frame_started.wait),
        ("Shooting", Key.EXIT),
        ("Cancelled", job.frame_may_end.set),
        ("Cancelled", Key.ENTER),
        *quit_from("Done"),
    ]
    panel = ScriptedPanel(script, (60, 8))
    assert run(panel, job) is not None
    assert any("stopped after 0 frames" in "".join(lines) for lines in panel.screens)
    assert job.shot[0] is job.shot[1]


def test_only_exit_cancels() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [*TO_REVIEW, ("Review", Key.ENTER)]
    script += [("Shooting", key) for key in Key if key is not Key.EXIT]
    script += [("Shooting", job.frame_may_end.set), *quit_from("Done")]
    assert run(ScriptedPanel(script), job) is not None


@pytest.mark.parametrize(
    ("method", "title"),
    [("predict", "Computing failed"), ("plan", "Planning failed"), ("shoot", "Capture failed")],
)
def test_error_is_shown_and_can_be_retried(method: str, title: str) -> None:
    job = FakeJob()
    job.before[method] = disconnect
    keys: Script = [*TO_REVIEW, ("Review", Key.ENTER)]
    before = keys[: {"predict": 2, "plan": 3, "shoot": 4}[method]]
    after = keys[len(before) :]
    script: Script = [
        *before,
        (title, Key.ENTER),  # retry: it is still disconnected
        (title, lambda: job.before.clear()),
        (title, Key.ENTER),
        *after,
        *quit_from("Done"),
    ]
    panel = ScriptedPanel(script, (60, 5))
    assert run(panel, job) is not None
    assert any(
        "the camera was disconnected; connect it again" in lines[1] for lines in panel.screens
    )


def test_error_offers_back_and_quit() -> None:
    job = FakeJob()
    job.before["plan"] = disconnect
    script: Script = [*TO_REVIEW, ("Planning failed", Key.RIGHT), ("Planning failed", Key.ENTER)]
    script += [("Exposures", Key.ENTER), *quit_from("Planning failed")]
    assert run(ScriptedPanel(script), job) is None
    assert len(job.planned) == 2


def test_internal_error_is_shown_and_then_raised() -> None:
    job = FakeJob()
    job.before["shoot"] = fail_internally
    script: Script = [*TO_REVIEW, ("Review", Key.ENTER), *quit_from("Capture failed")]
    panel = ScriptedPanel(script, (60, 5))
    with pytest.raises(ZeroDivisionError, match="division by zero"):
        run(panel, job)
    assert not panel.open
    assert any("ZeroDivisionError: division by zero" in lines[1] for lines in panel.screens)


def test_internal_error_is_logged_after_a_successful_retry(
    caplog: pytest.LogCaptureFixture,
) -> None:
    job = FakeJob()
    job.before["shoot"] = fail_internally
    panel = ScriptedPanel([])

    def repaired() -> None:
        job.before.clear()
        assert not caplog.records

    panel.script += [*TO_REVIEW, ("Review", Key.ENTER), ("Capture failed", repaired)]
    panel.script += [("Capture failed", Key.ENTER), *quit_from("Done")]
    with caplog.at_level(logging.WARNING):
        assert run(panel, job) is not None
    assert "ZeroDivisionError" in caplog.text


def test_keys_typed_ahead_do_not_shoot_an_unseen_plan() -> None:
    job = FakeJob()
    panel = ScriptedPanel([])

    def press_enter_repeatedly() -> None:
        panel.typed_ahead += [Key.ENTER] * 20

    job.before["plan"] = press_enter_repeatedly
    panel.script += [*TO_REVIEW, *quit_from("Review")]
    assert run(panel, job) is None
    assert job.shot == []


def test_interrupt_cancels_the_capture_and_closes_the_panel() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def control_c() -> None:
        job.frame_started.wait()
        raise KeyboardInterrupt

    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), ("Shooting", control_c)])
    with pytest.raises(KeyboardInterrupt):
        run(panel, job)
    assert not panel.open
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


def test_disconnected_panel_cancels_the_capture() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def unplug() -> None:
        job.frame_started.wait()
        raise CameraNotFoundError("the panel was disconnected")

    panel = ScriptedPanel([*TO_REVIEW, ("Review", Key.ENTER), ("Shooting", unplug)])
    with pytest.raises(CameraNotFoundError):
        run(panel, job)
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


def test_quitting_does_not_wait_for_a_prediction(monkeypatch: pytest.MonkeyPatch) -> None:
    job = FakeJob()
    may_end, begun = threading.Event(), threading.Event()

    def wait_for_permission() -> None:
        begun.set()
        may_end.wait()

    job.before["predict"] = wait_for_permission
    script: Script = [
        ("Desired", Key.ENTER),
        ("Dynamic", Key.ENTER),
        ("Computing", begun.wait),
        ("Computing", Key.EXIT),
        ("Dynamic", Key.EXIT),
        ("Desired", Key.EXIT),
    ]

    def join(thread: threading.Thread, timeout: float | None = None) -> None:
        raise AssertionError(f"run waits for {thread.name}")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "join", join)
        assert run(ScriptedPanel(script), job) is None
    may_end.set()


def test_abandoned_predictions_are_not_computed() -> None:
    job = FakeJob()
    may_end, begun = threading.Event(), threading.Event()

    def wait_for_permission() -> None:
        begun.set()
        may_end.wait()

    job.before["predict"] = wait_for_permission
    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER), ("Computing", begun.wait)]
    script += [("Computing", Key.EXIT)]
    for _ in range(3):
        script += [("Dynamic", Key.ENTER), ("Computing", Key.EXIT)]
    script += [("Dynamic", Key.UP), ("Dynamic", Key.ENTER), ("Computing", may_end.set)]
    script += [("Exposures", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    run(ScriptedPanel(script), job)
    assert job.predicted == [("log", 1000.0), ("log", 16000.0)]


class StepwiseCosts(FakeJob):
    """Yields the cost of one more number of exposures with each release of `may_find`."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[int] = []
        self.may_find = threading.Semaphore(0)

    def predict(self, response: str, dynamic_range: float) -> Iterator[Cost]:
        self.predicted.append((response, dynamic_range))
        for cost in COSTS:
            self.may_find.acquire()
            self.found.append(cost.count)
            yield cost


def test_slow_prediction_shows_its_progress() -> None:
    job = StepwiseCosts()
    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER)]
    script += [("Computing", job.may_find.release)] * 2
    script += [("2 computed", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    assert run(ScriptedPanel(script), job) is None
    assert job.found == [1, 2]


def test_abandoned_prediction_stops_at_the_next_cost() -> None:
    job = StepwiseCosts()
    script: Script = [("Desired", Key.ENTER), ("Dynamic", Key.ENTER)]
    script += [("Computing", job.may_find.release), ("1 computed", Key.EXIT)]
    script += [("Dynamic", Key.UP), ("Dynamic", Key.ENTER)]
    script += [("Computing", job.may_find.release)] * 7
    script += [("Exposures", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    run(ScriptedPanel(script), job)
    assert job.found == [1, 2, 1, 2, 3, 4, 5, 6]


def test_panel_that_is_too_small_is_refused() -> None:
    class Tiny(ScriptedPanel):
        def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
            raise AssertionError("must not be called")

    with pytest.raises(UsageError, match="only 16 x 2 characters; the menu needs 20 x 4"):
        run(Tiny([], (16, 2)), FakeJob())
