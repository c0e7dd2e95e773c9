"""The menu's loop with a scripted panel and a job without a camera."""

from __future__ import annotations

import logging
import threading
from dataclasses import replace

import pytest
from panel_fakes import CAMERA, OTHER_CAMERA, TO_REVIEW, FakeJob, Script, ScriptedPanel, quit_from

from camctl.errors import CameraDisconnectedError, CameraNotFoundError, UsageError
from camctl.menu.app import run
from camctl.menu.data import Choice, Settings
from camctl.menu.ports import Key, PanelDisconnectedError, Screen

SHOOT: Script = [*TO_REVIEW, ("Review", Key.ENTER)]
TO_MENU: Script = [("[Set]", Key.RIGHT), ("[Shoot]", Key.RIGHT), ("[Menu]", Key.ENTER)]


def disconnect() -> None:
    raise CameraDisconnectedError("the camera was disconnected", hint="connect it again")


def fail_internally() -> None:
    raise ZeroDivisionError("division by zero")


@pytest.mark.parametrize("size", [(16, 2), (20, 4), (60, 16)])
def test_five_keys_lead_from_the_start_to_a_finished_capture(size: tuple[int, int]) -> None:
    job = FakeJob()
    texts = ["[Set]", "ontrast", "Auto", "Recommended", "[Shoot]"]
    script: Script = [(text, Key.ENTER) for text in texts]
    summary = run(ScriptedPanel([*script, *quit_from("Again]")], size), lambda: job)
    assert summary is not None
    assert summary.folder == "captures/x"
    assert job.planned == [Choice("log", None)]
    assert len(job.shot) == 1
    assert job.closed


def test_quitting_at_once_returns_no_summary() -> None:
    job = FakeJob()
    assert run(ScriptedPanel(quit_from("[Set]")[1:]), lambda: job) is None
    assert job.planned == []


def test_a_time_budget_or_a_point_of_the_front_decides_the_exposures() -> None:
    job = FakeJob()
    down: Script = [("Exposures", Key.DOWN)] * 8
    script: Script = [*TO_REVIEW[:3], *down, (">Time budget", Key.ENTER), ("Time budget", Key.UP)]
    script += [("0.2 s", Key.ENTER), ("Review", Key.EXIT), *[("Exposures", Key.UP)] * 7]
    script += [(">Time / accuracy", Key.ENTER), (">1.3 s, 105 levels", Key.DOWN)]
    script += [(">3.1 s, 163 levels", Key.ENTER), ("Review", Key.EXIT), ("Exposures", Key.EXIT)]
    back: Script = [("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    # The same point of another range is not known: what is recommended is planned.
    script += [("Dynamic", Key.UP), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    script += [("[Set]", Key.RIGHT), ("[Shoot]", Key.ENTER), ("Review", Key.EXIT)]
    script += [("Exposures", Key.EXIT), *back]
    run(ScriptedPanel([*script, *quit_from("[Set]")[1:]], (60, 16)), lambda: job)
    assert job.traced == [Choice("log", None)]
    assert job.planned == [
        Choice("log", None, time_budget_s=0.2),
        Choice("log", 1000.0, time_budget_s=3.14 * 1.02),
        Choice("log", 16000.0),
    ]


def test_without_points_the_list_says_why() -> None:
    def fail() -> None:
        raise UsageError("the noise is unknown")

    job = FakeJob()
    job.before["trace"] = fail
    script: Script = [*TO_REVIEW[:3], ("Exposures", Key.DOWN), (">Time / accuracy", Key.ENTER)]
    script += [("the noise is unknown", Key.ENTER), ("the noise is unknown", Key.EXIT)]
    script += [("Exposures", Key.EXIT), ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    run(ScriptedPanel([*script, *quit_from("[Set]")[1:]], (60, 16)), lambda: job)
    assert job.planned == []


def test_every_choice_of_a_list_is_predicted() -> None:
    job = FakeJob()
    script: Script = [("[Set]", Key.ENTER), ("1.88 s, 100", Key.EXIT)]
    run(ScriptedPanel([*script, *quit_from("[Set]")[1:]]), lambda: job)
    assert [each.response for each in job.predicted[:4]] == ["log", "linear", "gamma", "auto"]


def test_cancelled_capture_can_be_planned_again() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [
        *SHOOT,
        ("Shooting", job.frame_started.wait),
        ("Shooting", Key.EXIT),
        ("Cancelled", job.frame_may_end.set),
        ("Cancelled", Key.RIGHT),
        ("[Retry]", Key.ENTER),
        ("Review", Key.ENTER),
        *quit_from("Done"),
    ]
    panel = ScriptedPanel(script, (60, 8))
    assert run(panel, lambda: job) is not None
    assert any("stopped after 0 frames" in "".join(lines) for lines in panel.screens)
    assert len(job.shot) == 2


def test_only_exit_cancels() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [*SHOOT]
    script += [("Shooting", key) for key in Key if key is not Key.EXIT]
    script += [("Shooting", job.frame_may_end.set), *quit_from("Done")]
    assert run(ScriptedPanel(script), lambda: job) is not None


@pytest.mark.parametrize(("method", "title"), [("plan", "Planning failed"), ("open", "No camera")])
def test_error_is_shown_and_can_be_retried(method: str, title: str) -> None:
    job = FakeJob()
    job.before[method] = disconnect
    script: Script = [] if method == "open" else list(TO_REVIEW)
    script += [(title, Key.ENTER), (title, job.before.clear), (title, Key.ENTER)]
    script += SHOOT if method == "open" else SHOOT[-1:]
    panel = ScriptedPanel([*script, *quit_from("Done")], (60, 5))
    assert run(panel, lambda: job) is not None
    assert any(
        "the camera was disconnected; connect it again" in lines[1] for lines in panel.screens
    )


def test_camera_that_is_unplugged_while_idle_comes_back_without_a_key() -> None:
    job, now = FakeJob(), Now()
    script: Script = [("[Set]", lambda: job.before.update(meter=disconnect, open=disconnect))]
    script += [("Ready", now.advance), ("No camera", now.advance)]
    script += [("No camera", job.before.clear), ("No camera", now.advance)]
    panel = ScriptedPanel([*script, *quit_from("[Set]")[1:]])
    run(panel, lambda: job, now=now)
    assert len(job.opened) >= 2


class Now:
    """A clock that a script advances."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def __call__(self) -> float:
        return self.time_s

    def advance(self, by_s: float = 60.0) -> None:
        self.time_s += by_s


def test_another_camera_can_be_chosen() -> None:
    job = FakeJob()
    script: Script = [*TO_MENU, ("Take", Key.DOWN), (">Series", Key.DOWN), (">Captures", Key.DOWN)]
    script += [(">Camera", Key.ENTER), (f">{CAMERA.name}", Key.DOWN)]
    script += [(f">{OTHER_CAMERA.name}", Key.ENTER), *quit_from("[Set]")[1:]]
    run(ScriptedPanel(script), lambda: job)
    assert job.opened == ["", OTHER_CAMERA.id]
    assert job.saved[-1].camera == OTHER_CAMERA.id


def test_interrupted_capture_is_resumed() -> None:
    job = FakeJob()
    script: Script = [*TO_MENU, ("Take", Key.DOWN), (">Series", Key.DOWN), (">Captures", Key.ENTER)]
    script += [("0002-1122-0830", Key.ENTER), *quit_from("Done")]
    run(ScriptedPanel(script), lambda: job)
    assert [past.name for past in job.resumed] == ["capture-0002-20261122-083000"]


def test_series_is_chosen_and_taken_with_the_keys() -> None:
    job = FakeJob()
    script: Script = [*TO_MENU, ("Take", Key.DOWN), (">Series", Key.ENTER)]
    script += [(">10 pictures", Key.ENTER), (">20 pictures", Key.DOWN), (">Every 1 min", Key.ENTER)]
    script += [(">Every 2 min", Key.DOWN), (">Start", Key.ENTER), *quit_from("Done")]
    run(ScriptedPanel(script), lambda: job)
    (taken,) = job.series_taken
    assert (taken.count, taken.interval_s) == (20, 120.0)
    assert job.saved[-1].repeat == 3


def test_series_is_cancelled_with_the_exit_key() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    script: Script = [*TO_MENU, ("Take", Key.DOWN), (">Series", Key.ENTER)]
    script += [("pictures", Key.DOWN), (">Every", Key.DOWN), (">Start", Key.ENTER)]
    script += [("0/10", Key.EXIT), *quit_from("Cancelled")]
    run(ScriptedPanel(script), lambda: job)
    assert len(job.series_taken) == 1
    assert job.running == 0


def test_settings_are_kept_as_they_are_changed() -> None:
    job = FakeJob()
    script: Script = [*TO_MENU, *[("Menu", Key.DOWN)] * 4, (">Settings", Key.ENTER)]
    script += [("timer 10 s", Key.ENTER), ("timer 30 s", Key.EXIT), ("Menu", Key.EXIT)]
    run(ScriptedPanel([*script, *quit_from("[Set]")[1:]], (60, 16)), lambda: job)
    assert job.saved[0] == replace(Settings(), timer=2)


def test_settings_that_cannot_be_kept_are_reported() -> None:
    job = FakeJob()
    job.before["save"] = disconnect
    script: Script = [("[Set]", Key.ENTER), ("Desired", Key.DOWN), ("Linear", Key.EXIT)]
    script += [("settings are not kept", Key.EXIT), *quit_from("[Set]")[2:]]
    run(ScriptedPanel(script, (60, 16)), lambda: job)


def test_self_timer_counts_down_and_shoots() -> None:
    job, now = FakeJob(), Now()
    script: Script = [*TO_REVIEW, ("Review", Key.RIGHT), ("[Timer]", Key.ENTER)]
    script += [(f"in {left} s", now.advance) for left in range(10, 0, -1)]
    run(ScriptedPanel([*script, *quit_from("Done")]), lambda: job, now=now)
    assert len(job.shot) == 1


def test_screen_saver_swallows_the_key_that_ends_it() -> None:
    job, now = FakeJob(), Now()
    panel = ScriptedPanel([("[Set]", lambda: now.advance(3600))], (20, 4))
    panel.script += [(" " * 20, Key.ENTER), *quit_from("[Set]")[1:]]
    run(panel, lambda: job, now=now)
    assert (" " * 20,) * 4 in panel.screens
    assert job.predicted == []


def test_internal_error_is_shown_and_then_raised() -> None:
    job = FakeJob()
    job.before["shoot"] = fail_internally
    panel = ScriptedPanel([*SHOOT, *quit_from("Capture failed")], (60, 5))
    with pytest.raises(ZeroDivisionError, match="division by zero"):
        run(panel, lambda: job)
    assert not panel.open
    assert any("ZeroDivisionError: division by zero" in lines[1] for lines in panel.screens)


def test_internal_error_is_logged_after_later_work_succeeded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    job = FakeJob()
    job.before["shoot"] = fail_internally
    script: Script = [*SHOOT, ("Capture failed", job.before.clear), ("Capture failed", Key.ENTER)]
    panel = ScriptedPanel([*script, ("Review", Key.ENTER), *quit_from("Done")])
    with caplog.at_level(logging.WARNING):
        assert run(panel, lambda: job) is not None
    assert "ZeroDivisionError" in caplog.text


def test_keys_typed_ahead_do_not_shoot_an_unseen_plan() -> None:
    job = FakeJob()
    panel = ScriptedPanel([])

    def press_enter_repeatedly() -> None:
        panel.typed_ahead += [Key.ENTER] * 20

    job.before["plan"] = press_enter_repeatedly
    script: Script = [*TO_REVIEW, ("Review", Key.EXIT), ("Exposures", Key.EXIT)]
    panel.script += [*script, ("Dynamic", Key.EXIT), ("Desired", Key.EXIT)]
    panel.script += quit_from("[Set]")[1:]
    assert run(panel, lambda: job) is None
    assert job.shot == []


def test_interrupt_cancels_the_capture_and_closes_the_panel() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def control_c() -> None:
        job.frame_started.wait()
        raise KeyboardInterrupt

    panel = ScriptedPanel([*SHOOT, ("Shooting", control_c)])
    with pytest.raises(KeyboardInterrupt):
        run(panel, lambda: job)
    assert not panel.open
    assert job.closed
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


def test_panel_that_fails_cancels_the_capture() -> None:
    job = FakeJob()
    job.frame_may_end.clear()

    def fail() -> None:
        job.frame_started.wait()
        raise CameraNotFoundError("the terminal was closed")

    panel = ScriptedPanel([*SHOOT, ("Shooting", fail)])
    with pytest.raises(CameraNotFoundError):
        run(panel, lambda: job)
    assert "menu job" not in {thread.name for thread in threading.enumerate()}


class UnpluggedPanel(ScriptedPanel):
    """A panel that is not there for some of the attempts to open it, and that can be unplugged."""

    absent = 0

    def __enter__(self) -> UnpluggedPanel:
        if self.absent:
            self.absent -= 1
            raise PanelDisconnectedError("the panel is not there")
        super().__enter__()
        return self

    def show(self, screen: Screen) -> int:
        if self.absent:
            raise PanelDisconnectedError("the panel was unplugged")
        return super().show(screen)


def test_panel_that_is_unplugged_during_a_capture_is_opened_again() -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    panel = UnpluggedPanel([])
    waited: list[float] = []

    def unplug() -> None:
        job.frame_started.wait()
        panel.absent = 3
        job.frame_may_end.set()

    panel.script += [*SHOOT, ("Shooting", unplug), *quit_from("Done")]
    assert run(panel, lambda: job, wait=waited.append) is not None
    assert len(waited) == 4
    assert len(job.shot) == 1


def test_panel_that_is_not_there_at_the_start_is_an_error() -> None:
    panel = UnpluggedPanel([])
    panel.absent = 1
    with pytest.raises(PanelDisconnectedError, match="not there"):
        run(panel, FakeJob)


def test_work_that_the_user_left_ends_before_the_menu_does() -> None:
    job = FakeJob()
    stop = threading.Event()
    job.before["predict"] = lambda: stop.wait(5)
    script: Script = [("[Set]", Key.ENTER), ("Desired", Key.EXIT), *quit_from("[Set]")[1:]]
    panel = ScriptedPanel(script)

    def release_and_quit() -> None:
        stop.set()
        panel.typed_ahead.append(Key.ENTER)

    panel.script[-1] = ("[Quit]", release_and_quit)
    run(panel, lambda: job)
