"""The part `truth` of tests/bench/bench_live.py finds what it is there to find."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from unittest import mock

import pytest

from camctl.interface.controls import ExposureControls
from camctl.livestream.window import SlotState, Window


def bench() -> ModuleType:
    path = Path(__file__).parents[1] / "bench" / "bench_live.py"
    spec = importlib.util.spec_from_file_location("bench_live", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_older_slots_are_marked(capsys: pytest.CaptureFixture[str]) -> None:
    bench().truth(3000)
    assert "are marked and 0 not" in capsys.readouterr().out


def test_a_missing_mark_is_an_error() -> None:
    states = Window.states

    def unmarked(window: Window, controls: ExposureControls) -> tuple[SlotState, ...]:
        return tuple(replace(each, is_old=False) for each in states(window, controls))

    with mock.patch.object(Window, "states", unmarked), pytest.raises(SystemExit):
        bench().truth(3000)
