"""What holds for every command: help, errors of one line, exit statuses, late imports."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import click
import pytest

from camctl.cli import COMMANDS, cli
from camctl.errors import CamctlError, CaptureError, InterruptedCaptureError, UsageError

if TYPE_CHECKING:
    from conftest import Run

GROUPS = [("calibrate",), ("profile",), ("table",)]
LINES = [
    *((name,) for name in COMMANDS if (name,) not in GROUPS),
    ("calibrate", "delay"),
    ("profile", "list"),
    ("profile", "show"),
    ("profile", "remove"),
    ("table", "show"),
    ("table", "build"),
]


def command_at(line: tuple[str, ...]) -> click.Command:
    context = click.Context(cli)
    found: click.Command = cli
    for name in line:
        assert isinstance(found, click.Group)
        below = found.get_command(context, name)
        assert below is not None
        found = below
    return found


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; from camctl.cli import main; main(['--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Commands:" in done.stdout
    imported = set(done.stdout.splitlines()[-1].split())
    assert "camctl.cli.shoot" in imported
    heavy = {"numpy", "cv2", "pydantic", "rich", "tifffile", "camctl.camera", "sim", "menu"}
    assert not heavy & imported


@pytest.mark.parametrize("line", [(), *GROUPS, *LINES])
def test_help_shows_examples_and_every_option(run: Run, line: tuple[str, ...]) -> None:
    page = run(*line, "--help")
    assert page.status == 0
    assert page.err == ""
    assert "Examples:" in page.out
    for parameter in command_at(line).params:
        word = parameter.metavar if isinstance(parameter, click.Argument) else parameter.opts[-1]
        assert word in page.out
    assert run(*line, "-h") == page


@pytest.mark.parametrize("line", LINES)
def test_examples_are_understood(line: tuple[str, ...]) -> None:
    """Each example of a help page parses: its options exist and its values are accepted."""
    made = command_at(line)
    examples = made.examples  # type: ignore[attr-defined]
    assert 2 <= len(examples) <= 5
    own = [words for words, _ in examples if words.split()[1 : len(line) + 1] == list(line)]
    assert own
    for words in own:
        own_words = words.partition(" | ")[0].split()
        made.make_context("camctl", own_words[len(line) + 1 :])


@pytest.mark.parametrize("line", LINES)
def test_every_option_says_what_it_is_for(line: tuple[str, ...]) -> None:
    for parameter in command_at(line).params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.opts
        else:
            assert parameter.metavar, parameter.opts


@pytest.mark.parametrize("line", [(), *GROUPS])
def test_group_without_a_command_shows_its_help(run: Run, line: tuple[str, ...]) -> None:
    assert run(*line) == run(*line, "--help")


def test_version(run: Run) -> None:
    import camctl

    assert run("--version").out == f"camctl {camctl.__version__}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["shot"], "unknown command 'shot'; did you mean shoot?"),
        (["table", "biuld"], "unknown command 'biuld'; did you mean build?"),
        (["--debig"], "unknown option '--debig'; did you mean --debug"),
        (["shoot", "--respones", "log"], "unknown option '--respones'; did you mean --response"),
        (["shoot", "--response", "lograrithm"], "unknown response 'lograrithm'"),
        (["shoot", "--response", "liner"], "unknown response 'liner'; did you mean linear?"),
        (["shoot", "--range", "hihg"], "unknown dynamic range 'hihg'; did you mean high?"),
        (["shoot", "--mains", "55"], "unknown mains frequency '55'"),
        (["shoot", "--scene"], "option '--scene' requires an argument; see camctl shoot --help"),
        (["shoot", "somewhere"], "got unexpected extra argument (somewhere)"),
        (["evaluate"], "missing option '--ratios'"),
        (["solve", "--range", "1"], "--range: 1 is no dynamic range"),
        (["solve", "--range", "0.5"], "--range: 0.5 is no dynamic range"),
        (["solve", "--range", "nan"], "--range: nan is no dynamic range"),
        (["solve", "--range", "inf"], "--range: inf is no dynamic range"),
        (["solve", "-n", "0"], "--exposures: 0 is not a whole number of exposures, 1 to 16"),
        (["solve", "-n", "17"], "--exposures: 17 is not a whole number of exposures, 1 to 16"),
        (["solve", "-n", "three"], "--exposures: 'three' is not a whole number of exposures"),
        (["solve", "--bits", "17"], "--bits: 17 is not a whole number of bits, 1 to 16"),
        (["solve", "--phase", "1"], "--phase: 1 is not a phase of at least 0 and below 1"),
        (["solve", "--levels", "0"], "--levels: 0 is not a positive number of levels"),
        (["solve", "--levels", "nan"], "--levels: nan is not finite"),
        (["solve", "--seed", "-1"], "--seed: -1 is not a whole number from 0"),
        (["evaluate", "--ratios", "1,-2"], "--ratios: exposure -2 is not positive"),
        (["evaluate", "--ratios", "1,0"], "--ratios: exposure 0 is not positive"),
        (["evaluate", "--ratios", "1,inf"], "--ratios: inf is not finite"),
        (["evaluate", "--ratios", "1,nan"], "--ratios: nan is not finite"),
        (["evaluate", "--ratios", "1,two"], "--ratios: 'two' is not a number"),
        (["evaluate", "--ratios", ","], "--ratios: no exposures"),
        (["evaluate", "--ratios", "1", "--p", "0.5"], "--p: 0.5 is not a number of at least 1"),
        (["shoot", "--base", "0"], "--base: 0 is not a time in seconds"),
        (["shoot", "--base", "1/0"], "--base: 1/0 is not a time in seconds"),
        (["shoot", "--base", "soon"], "--base: 'soon' is not a time in seconds"),
        (["shoot", "--compensation", "inf"], "--compensation: inf is not finite"),
        (["shoot", "--size", "640"], "--size: '640' is no size; for example --size 640x480"),
        (["shoot", "--ratios", "1,2,4", "-n", "2"], "--ratios names 3 exposures, -n says 2"),
        (["shoot", "-O", "format"], "--camera-option: 'format' is not NAME=VALUE; for example"),
        (["shoot", "-O", "=y16"], "--camera-option: '=y16' is not NAME=VALUE"),
        (["shoot", "-O", "size=9x9", "-O", "size=8x8"], "option 'size' is said twice; say it once"),
        (["menu", "-O", "size=9x9", "--size", "9x9"], "option 'size' is said twice; say it once"),
        (["shoot", "-O", "fromat=y16"], "unknown camera option 'fromat'; known"),
        (["shoot", "-O", "scenes=room"], "unknown camera option 'scenes'; did you mean scene or"),
        (["calibrate", "delay", "--trials", "1"], "--trials: 1 is not a whole number of trials"),
        (["calibrate", "dealy"], "unknown command 'dealy'; did you mean delay?"),
        (["profile", "show"], "missing argument 'NAME'; see camctl profile show --help"),
        (["profile", "show", "x"], "no profile 'x', and no other; camctl calibrate makes them"),
        (["profile", "remove", "x"], "no profile 'x', and no other; camctl calibrate makes them"),
        (["cameras", "--udev-rules", "--json"], "--udev-rules goes alone"),
        (
            ["shoot", "--resume", "x", "-O", "a=b"],
            "--resume goes on as it was planned, without --c",
        ),
        (["shoot", "--resume", "x", "-n", "2"], "--resume goes on as it was planned, without --ex"),
    ],
)
def test_words_that_are_off_get_one_line_and_status_2(
    run: Run, words: list[str], message: str
) -> None:
    ran = run(*words)
    assert message in ran.error
    assert ran.status == 2


@pytest.mark.parametrize("line", LINES)
def test_every_command_takes_debug(run: Run, line: tuple[str, ...]) -> None:
    ran = run(*line, "--debug", "--no-such-option")
    assert ran.status == 2
    assert ran.err.endswith("\n")
    assert "camctl: unknown option '--no-such-option'" in ran.err.splitlines()[-1]


def stand_in(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(**_: bool) -> None:
        raise error

    import camctl.backends

    monkeypatch.setattr(camctl.backends, "list_backends", fail)


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (CamctlError("it rains", hint="wait"), 1, "it rains; wait"),
        (CamctlError("two\nlines"), 1, "two lines"),
        (UsageError("no such thing"), 2, "no such thing"),
        (CaptureError("frame 2 is missing"), 1, "frame 2 is missing"),
        (InterruptedCaptureError("stopped"), 130, "stopped"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (BrokenPipeError(32, "stalled"), 1, "internal error: BrokenPipeError: [Errno 32] stalled"),
        (
            ValueError("odd\nthing"),
            1,
            "internal error: ValueError: odd thing; run again",
        ),
        (AssertionError(), 1, "internal error: AssertionError; run again with --debug"),
    ],
)
def test_errors_of_a_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, line: str
) -> None:
    stand_in(monkeypatch, error)
    ran = run("cameras")
    assert ran.error.startswith(line)
    assert ran.status == status


@pytest.mark.parametrize("words", [("--debug", "cameras"), ("cameras", "--debug")])
@pytest.mark.parametrize("error", [CamctlError("it rains"), ValueError("odd")])
def test_debug_shows_the_traceback_before_the_line(
    run: Run, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], error: Exception
) -> None:
    stand_in(monkeypatch, error)
    ran = run(*words)
    assert ran.err.startswith("Traceback")
    assert f"camctl: {'' if isinstance(error, CamctlError) else 'internal error: '}" in ran.err
    assert ran.status == 1


@pytest.mark.parametrize("words", ["--help", "evaluate --ratios 1,2", "evaluate --help"])
def test_reader_that_has_gone_gets_no_complaint(words: str) -> None:
    code = f"import sys; from camctl.cli import main; sys.exit(main({words.split()!r}))"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_completion_offers_commands(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_CAMCTL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "camctl so")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert run().out == "plain,solve\n"
