"""Rules for all commands: help pages, one-line errors, exit statuses, completion, late imports."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import click
import pytest
from command_line import Ran, Run

import camctl
from camctl.cli import COMMANDS, cli
from camctl.cli.commands import Command
from camctl.errors import CamctlError, CaptureError, InterruptedCaptureError, UsageError

Path = tuple[str, ...]

GROUPS: list[Path] = [("calibrate",), ("profile",), ("table",), ("tradeoff",)]
LINES: list[Path] = [
    *((name,) for name in COMMANDS if (name,) not in GROUPS),
    ("help",),
    ("calibrate", "delay"),
    ("profile", "list"),
    ("profile", "show"),
    ("profile", "remove"),
    ("table", "show"),
    ("table", "build"),
    ("tradeoff", "capture"),
    ("tradeoff", "simulation"),
    ("tradeoff", "solver"),
]
HEAVY = {"numpy", "cv2", "pydantic", "rich", "tifffile", "camctl.interface.camera", "menu"}
"""Modules that neither help nor completion may import: they take long."""


UNFIT = (
    "shoot --sensor nix",
    "shoot --scene nix",
    "shoot --camera nix",
    "shoot --camera coolpix",
    "shoot --camera effective",
    "shoot --camera opencv",
    "shoot --camera ptpip",
    "solve --curve nix",
    "shoot --gamma 2 --response log",
    "shoot --accuracy 1e9 -n 2",
    "shoot --base 1000",
    "shoot --ratios 1,1e9",
    "shoot --time-budget 1e-9",
    "preview --base 1000",
    "live --output - --fps 1e4",
    "live --output - --base 1000",
    "simulate -o x.xyz",
    "tradeoff capture --plot x.xyz",
)
"""Names and values that do not fit, to each other or to the camera."""

UNUSABLE = (
    "shoot --response bad",
    "solve --curve bad",
    "solve --settings bad",
    "solve --settings nix",
    "evaluate --ratios 1,2 --response bad",
    "table build --curve bad",
    "shoot --set table=bad",
    "shoot --scene nix.npy",
    "shoot --sensor nix.json",
    "merge bad bad",
    "resume nix",
    "shoot -o full",
    "live --output exr:full --count 1",
    "live --output v4l2:full --count 1",
    "shoot --camera v4l2:full",
)
"""Files, cameras and folders that cannot be used."""


def command_at(line: Path) -> click.Command:
    context = click.Context(cli)
    found: click.Command = cli
    for name in line:
        assert isinstance(found, click.Group)
        below = found.get_command(context, name)
        assert below is not None
        found = below
    return found


def run_alone(*arguments: str) -> tuple[str, set[str]]:
    """Return the output of a command line in a process of its own, and what it imported."""
    code = "import sys; from camctl.cli import main; main(sys.argv[1:]); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    out, _, modules = done.stdout.rstrip("\n").rpartition("\n")
    return out, set(modules.split())


def test_help_imports_no_heavy_module() -> None:
    out, imported = run_alone("--help")
    assert "Commands:" in out
    assert "camctl.cli.shoot" in imported
    assert not (HEAVY | {"sim"}) & imported


def test_completion_imports_no_heavy_module() -> None:
    code = """import os, sys
from camctl.cli import main
for option in ("response", "range", "scene", "sensor", "camera"):
    os.environ["COMP_WORDS"] = f"camctl shoot --{option} "
    main([])
print(*sys.modules)"""
    environment = {**os.environ, "_CAMCTL_COMPLETE": "bash_complete", "COMP_CWORD": "3"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    *offers, modules = done.stdout.splitlines()
    assert {"plain,auto", "plain,high", "plain,room", "plain,phone", "plain,sim"} <= set(offers)
    assert not HEAVY & set(modules.split())


@pytest.mark.parametrize("line", [(), *GROUPS, *LINES])
def test_help_shows_examples_and_every_option(run: Run, line: Path) -> None:
    page = run(*line, "--help")
    assert page.status == 0
    assert page.err == ""
    assert "Examples:" in page.out
    for parameter in command_at(line).params:
        is_argument = isinstance(parameter, click.Argument)
        name = parameter.metavar if is_argument else parameter.opts[-1]
        assert name is not None
        assert name in page.out
    assert run(*line, "-h") == page
    assert run("help", *line) == page


@pytest.mark.parametrize("line", LINES)
def test_examples_of_the_help_page_parse(line: Path) -> None:
    """The options of each example exist, and its values are accepted."""
    command = command_at(line)
    assert isinstance(command, Command)
    assert 2 <= len(command.examples) <= 5
    own = [text for text, _ in command.examples if text.split()[1 : len(line) + 1] == list(line)]
    assert own
    for text in own:
        arguments = text.partition(" | ")[0].split()
        command.make_context("camctl", arguments[len(line) + 1 :])


@pytest.mark.parametrize("line", LINES)
def test_every_option_has_a_help_text(line: Path) -> None:
    for parameter in command_at(line).params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.opts
        else:
            assert parameter.metavar, parameter.opts


@pytest.mark.parametrize("line", [(), *GROUPS])
def test_group_without_a_command_shows_its_help(run: Run, line: Path) -> None:
    assert run(*line) == run(*line, "--help")


@pytest.mark.parametrize("option", ["-V", "--version"])
def test_version(run: Run, option: str) -> None:
    assert run(option) == Ran(0, f"camctl {camctl.__version__}\n", "")


def test_python_runs_the_package() -> None:
    module = [sys.executable, "-m", "camctl"]
    done = subprocess.run([*module, "-V"], capture_output=True, text=True, check=True)
    assert done.stdout == f"camctl {camctl.__version__}\n"
    failed = subprocess.run([*module, "shot"], capture_output=True, text=True, check=False)
    assert failed.returncode == 2
    assert failed.stderr == "camctl: unknown command 'shot'; did you mean shoot?\n"


WHOLE_TO_64 = "expected a whole number from 1 to 64"
A_TIME = "expected a time in seconds such as 0.004 or 1/250"
NO_PROFILES = "unknown profile 'x': there are no profiles; make one: calibrate a camera"
RATIOS = "expected numbers from 1e-100 to 1e100, such as 1,2,4"


@pytest.mark.parametrize("line", UNFIT)
def test_names_and_values_that_do_not_fit_have_status_2_in_every_command(
    run: Run, line: str
) -> None:
    assert run(*line.split()).status == 2


@pytest.mark.parametrize("line", UNUSABLE)
def test_files_cameras_and_results_that_cannot_be_used_have_status_1_in_every_command(
    run: Run, line: str
) -> None:
    pathlib.Path("bad").write_text("no numbers\n")
    pathlib.Path("full").mkdir()
    pathlib.Path("full/file").touch()
    assert run(*line.split()).status == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("shot", "unknown command 'shot'; did you mean shoot?"),
        ("table biuld", "unknown command 'biuld'; did you mean build?"),
        ("help solve x", "camctl solve has no commands of its own"),
        ("--debig", "unknown option '--debig'; did you mean --debug"),
        ("shoot --respones log", "unknown option '--respones'; did you mean --response"),
        ("shoot --response liner", "unknown response 'liner'; did you mean linear?"),
        ("shoot --range hihg", "unknown dynamic range 'hihg'; did you mean high?"),
        ("shoot --set mains=55", "unknown mains frequency '55'"),
        ("shoot --set main=50", "unknown setting 'main'; did you mean mains?"),
        ("shoot --set aperture=1", "invalid value for --set aperture: 1; expected yes or no"),
        ("shoot --set levels=0", "invalid value for --set levels: 0; expected a number of levels"),
        ("shoot --set mains=50 --set mains=60", "a setting of --set is given twice; give it once"),
        ("shoot --scene", "option '--scene' requires an argument; see camctl shoot --help"),
        ("shoot folder", "unexpected argument 'folder'; see camctl shoot --help"),
        ("evaluate", "option --ratios is missing; see camctl evaluate --help"),
        ("profile show", "argument NAME is missing; see camctl profile show --help"),
        ("solve --range 1", "invalid value for --range: 1; the range must be above 1"),
        ("solve --range inf", "invalid value for --range: inf; the range must be finite"),
        (
            "evaluate --ratios 1,,2",
            "invalid value for --ratios: 1,,2; a value is missing beside a comma",
        ),
        ("solve -n 0", f"invalid value for --exposures: 0; {WHOLE_TO_64}"),
        ("solve -n three", f"invalid value for --exposures: three; {WHOLE_TO_64}"),
        (
            "solve --phase 1",
            "invalid value for --phase: 1; expected a phase of at least 0 and below 1",
        ),
        (
            "solve --levels 0",
            "invalid value for --levels: 0; expected a number of levels from 1 to 1e7",
        ),
        ("solve --seed -1", "invalid value for --seed: -1; expected a whole number of at least 0"),
        (
            "solve -n 16 --bits 16 --settings 1,2,3",  # before a search of half a minute
            "16 different exposures cannot be chosen from 3 settings; request at most 3",
        ),
        ("evaluate --ratios 1,-2", f"invalid value for --ratios: -2; {RATIOS}"),
        ("evaluate --ratios 1,1e-320", f"invalid value for --ratios: 1e-320; {RATIOS}"),
        ("evaluate --ratios 1,nan", f"invalid value for --ratios: nan; {RATIOS}"),
        ("evaluate --ratios ,", f"invalid value for --ratios: ,; {RATIOS}"),
        (
            "evaluate --ratios 1 --p 0.5",
            "invalid value for --p: 0.5; expected a number from 1 to 16",
        ),
        ("shoot --base 1/0", f"invalid value for --base: 1/0; {A_TIME}, or auto"),
        (
            "shoot --compensation inf",
            "invalid value for --compensation: inf; expected a number of stops",
        ),
        (
            "simulate --size 640",
            "invalid value for --size: 640; expected WIDTHxHEIGHT such as 640x480",
        ),
        ("shoot --ratios 1,2,4 -n 2", "--ratios has 3 exposures but -n is 2; leave -n out"),
        ("shoot --ratios 1,2 --time-budget 1", "--ratios cannot be combined with --time-budget"),
        ("shoot --ratios 1,2 --response auto", "--ratios cannot be combined with --response auto"),
        ("shoot --gamma 0.4 --response auto", "--gamma cannot be combined with --response auto"),
        (
            "shoot -O format",
            "invalid value for --camera-option: format; expected NAME=VALUE such as format=y16",
        ),
        ("shoot -O =y16", "invalid value for --camera-option: =y16; expected NAME=VALUE"),
        ("shoot -O size=9x9 -O size=8x8", "camera option 'size' is given twice; give it once"),
        ("menu -O scene=room --scene room", "camera option 'scene' is given twice; give it once"),
        ("shoot -O fromat=y16", "unknown camera option 'fromat'; did you mean"),
        ("profile show x", NO_PROFILES),
        ("cameras --udev-rules --json", "--udev-rules cannot be combined with --json"),
        (
            "resume x -O a=b",
            "--camera-option needs --camera here; the capture goes on with the options that it was "
            "begun with",
        ),
        ("resume x -n 2", "unknown option '-n'; the capture goes on with the options"),
    ],
)
def test_usage_error_is_one_line_with_status_2(run: Run, line: str, message: str) -> None:
    ran = run(*line.split())
    assert message in ran.err
    assert ran.err.startswith("camctl: ")
    assert ran.err.count("\n") == 1
    assert ran.status == 2
    if "--json" not in line:
        assert ran.out == ""


def fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let `camctl cameras` raise an error."""

    def fail(**_: bool) -> None:
        raise error

    monkeypatch.setattr("camctl.interface.backends.list_backends", fail)


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (CamctlError("the disk is full", hint="free space"), 1, "the disk is full; free space"),
        (CamctlError("two\nlines"), 1, "two\\nlines"),
        (UsageError("unknown option"), 2, "unknown option"),
        (CaptureError("frame 2 is missing"), 1, "frame 2 is missing"),
        (InterruptedCaptureError("stopped"), 130, "stopped"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (BrokenPipeError(32, "stalled"), 1, "internal error: BrokenPipeError: [Errno 32] stalled"),
        (ValueError("odd\nthing"), 1, "internal error: ValueError: odd thing; run again"),
        (AssertionError(), 1, "internal error: AssertionError; run again with --debug"),
    ],
)
def test_error_of_a_command_is_one_line(
    run: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, line: str
) -> None:
    fail_with(monkeypatch, error)
    ran = run("cameras")
    assert ran.error.startswith(line)
    assert ran.status == status


@pytest.mark.parametrize(
    ("error", "status", "content"),
    [
        (
            CaptureError("frame 2 is missing", hint="shoot again"),
            1,
            {"type": "CaptureError", "message": "frame 2 is missing", "hint": "shoot again"},
        ),
        (
            KeyboardInterrupt(),
            130,
            {"type": "KeyboardInterrupt", "message": "interrupted", "hint": None},
        ),
        (
            ValueError("odd"),
            1,
            {
                "type": "ValueError",
                "message": "internal error: ValueError: odd",
                "hint": "run again with --debug for the traceback",
            },
        ),
    ],
)
def test_error_with_json_is_an_object_and_one_line(
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    status: int,
    content: dict[str, str | None],
) -> None:
    fail_with(monkeypatch, error)
    ran = run("cameras", "--json")
    assert ran.json == {"format_version": 1, "error": content}
    assert ran.err == run("cameras").err
    assert ran.err.count("\n") == 1
    assert ran.status == status


@pytest.mark.parametrize(
    ("line", "message", "hint"),
    [
        ("solve --json -n 0", "invalid value for --exposures: 0", WHOLE_TO_64),
        ("solve --json --phas x", "unknown option '--phas'", "did you mean --phase?"),
        ("solv --json", "unknown command 'solv'", "did you mean solve or live?"),
        ("evaluate --json", "option --ratios is missing", "see camctl evaluate --help"),
    ],
)
def test_usage_error_with_json_is_an_object(run: Run, line: str, message: str, hint: str) -> None:
    ran = run(*line.split())
    content = {"type": "UsageError", "message": message, "hint": hint}
    assert ran.json == {"format_version": 1, "error": content}
    assert ran.err == f"camctl: {message}; {hint}\n"
    assert ran.status == 2


@pytest.mark.parametrize("arguments", [("--debug", "cameras"), ("cameras", "--debug")])
@pytest.mark.parametrize(
    ("error", "line"),
    [
        (CamctlError("the disk is full"), "camctl: the disk is full"),
        (ValueError("odd"), "camctl: internal error: ValueError: odd; run again"),
    ],
)
def test_debug_shows_the_traceback_before_the_line(
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    error: Exception,
    line: str,
) -> None:
    fail_with(monkeypatch, error)
    ran = run(*arguments)
    assert ran.err.startswith("Traceback")
    assert ran.err.splitlines()[-1].startswith(line)
    assert ran.status == 1


@pytest.mark.parametrize("line", ["evaluate --ratios 1,2", "evaluate --ratios 0 --json"])
def test_closed_output_is_not_an_internal_error(line: str) -> None:
    code = f"import sys; from camctl.cli import main; sys.exit(main({line.split()!r}))"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writer)
    if "--json" in line:
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert done.stderr.startswith("camctl: invalid value for --ratios: 0;")
    else:
        assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("shoot -O size=64x48 -o file/new", "choose another folder (-o PATH)"),
        ("cameras --record file/new", "choose another folder"),
        ("menu --panel image:file/new", "choose another folder"),  # -o is for captures
    ],
)
def test_an_error_of_a_file_names_the_option_for_this_file(
    run: Run, line: str, advice: str
) -> None:
    pathlib.Path("file").touch()
    ran = run(*line.split())
    reason = "cannot write file/new: a part of the path is a file"
    assert (ran.status, ran.error) == (1, f"{reason}; {advice}")
