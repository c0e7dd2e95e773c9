"""The README and the documentation pages: examples run, commands exist, links lead somewhere."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import click
import cv2
import numpy as np
import pytest

import camctl
from camctl.cli import main

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
TUTORIAL = ROOT / "docs/tutorials/first-pictures.md"
API = ROOT / "docs/reference/api.md"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\((?!https?://)([^)#\s]+)(?:#[^)]*)?\)")


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of one language."""
    return [text for kind, text in _BLOCK.findall(page.read_text("utf-8")) if kind == language]


def commands() -> Iterator[tuple[str, list[str]]]:
    """Yield (page, arguments) of every camctl command in the shell blocks."""
    for page in PAGES:
        for block in blocks(page, "sh"):
            for line in block.replace("\\\n", " ").splitlines():
                for part in re.split(r"&&|\|", line):
                    words = shlex.split(part, comments=True)
                    if words and Path(words[0]).name == "camctl":
                        yield str(page.relative_to(ROOT)), words[1:]


def options_of(command: click.Command) -> set[str]:
    """Return the options of a command and of all its subcommands."""
    found = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            found |= options_of(below) if below is not None else set()
    return found


def test_the_readme_fits_on_one_page() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 150


def test_the_python_example_of_the_readme_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (example,) = blocks(ROOT / "README.md", "python")
    assert len(example.strip().splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("relative exposures (1.0, ")
    assert 50 < int(printed[1].removeprefix("effective levels with noise ")) < 100
    assert "(768, 1024, 3)" in printed[2]
    assert {path.name for path in (tmp_path / "room").iterdir()} >= {"radiance.exr", "report.json"}


def test_the_exposures_for_the_tile_floor_are_those_that_are_chosen() -> None:
    request = camctl.CaptureRequest(response="log", dynamic_range="medium", count=3)
    with camctl.open_camera("sim", scene="tile-floor", sensor="ideal-6") as camera:
        plan = camctl.plan_capture(camera, request)
    for page, ratios in (
        (PAGES[0], r"exposures 1, ([\d.]+), ([\d.]+), chosen"),
        (TUTORIAL, r"now 1, ([\d.]+) and ([\d.]+) times"),
    ):
        ((second, third),) = re.findall(ratios, page.read_text("utf-8"))
        assert (float(second), float(third)) == pytest.approx(plan.exposures[1:], rel=0.01)
    levels = re.findall(r"([\d.]+) with noise, .* \(planned", TUTORIAL.read_text("utf-8"))
    assert float(levels[1]) == pytest.approx(plan.effective_levels, rel=0.001)


@pytest.mark.parametrize(("page", "arguments"), list(commands()), ids=lambda value: str(value)[:60])
def test_a_command_of_the_documentation_is_valid(page: str, arguments: list[str]) -> None:
    from camctl.cli import cli

    command: click.Command = cli
    # With the settings: click keeps the help option that the first context of a command makes.
    context = click.Context(cli, info_name="camctl", **cli.context_settings)
    rest = arguments
    while rest and isinstance(command, click.Group):
        name, found, rest = command.resolve_command(context, rest)
        assert found is not None, f"{page}: {arguments}"
        command, context = found, click.Context(found, parent=context, info_name=name)
    known = {option for parameter in command.get_params(context) for option in parameter.opts}
    used = {re.split("=", word)[0] for word in rest if re.match(r"--?[a-zA-Z]", word)}
    assert used <= known, f"{page}: {sorted(used - known)}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    missing = [
        target
        for target in _LINK.findall(page.read_text("utf-8"))
        if not (page.parent / target).exists()
    ]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_names_its_language(page: Path) -> None:
    fences = re.findall(r"^```.*$", page.read_text("utf-8"), re.MULTILINE)
    assert len(fences) % 2 == 0
    assert "```" not in fences[::2]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_an_option_named_in_the_text_exists(page: Path) -> None:
    from camctl.cli import cli

    text = _BLOCK.sub("", page.read_text("utf-8"))
    spans = re.findall(r"`((?:camctl |-)[^`\n]*)`", text)
    used = {option for span in spans for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", span)}
    known = options_of(cli) | {"--help"}
    assert used <= known


def test_the_layers_of_the_architecture_are_those_that_are_checked() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    (layers,) = [
        each["layers"] for each in contracts["contracts"] if each.get("containers") == ["camctl"]
    ]
    page = ROOT / "CONTRIBUTING.md"
    assert blocks(page, "text")[-1].splitlines() == layers[1:]  # below __main__
    text = page.read_text("utf-8")
    packages = re.findall(r"^\| `(?:camctl/)?(\w+)(?:/|\.py)` \|", text, re.MULTILINE)
    assert sorted(packages) == sorted(name for layer in layers[1:] for name in layer.split(" | "))


def test_every_public_name_is_in_the_api_reference() -> None:
    documented = re.findall(
        r"^\.\. auto(?!module)\w+:: camctl\.(\w+)$", API.read_text("utf-8"), re.MULTILINE
    )
    documented += [
        name for name in camctl._SUBMODULES if f".. automodule:: camctl.{name}\n" in API.read_text()
    ]
    assert sorted(documented) == [name for name in dir(camctl) if not name.startswith("_")]


@pytest.mark.parametrize(
    "page",
    [
        "reference/api.md",
        *(
            pytest.param(page, marks=pytest.mark.slow)
            for page in (
                "tutorials/python.md",
                "explanation/exposures.md",
                "how-to/calibration.md",
                "how-to/vision.md",
                "how-to/live.md",
                "how-to/adapters.md",
            )
        ),
    ],
)
def test_a_python_example_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    examples = blocks(ROOT / "docs" / page, "python")
    assert examples
    if page == "how-to/adapters.md" and find_spec("ophyd_async") is None:
        pytest.skip("ophyd-async is not installed")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for example in examples:
        exec(compile(example, page, "exec"), names)
    assert "nan" not in capsys.readouterr().out


#: Files of a reader's own, as the pages describe them.
_IRRADIANCE = np.linspace(0, 1, 50)
_FILES = {
    "response.txt": (_IRRADIANCE, _IRRADIANCE**0.5),
    "mine.txt": (_IRRADIANCE[1:], _IRRADIANCE[1:] ** 0.45),
    "times.txt": (2.0 ** (np.arange(-39, 16) / 3),),
}
#: "http" and "alpaca" end with Ctrl-C.
_NEEDS_A_DEVICE = (
    "v4l2:",
    "ptp",
    "coolpix:",
    "menu",
    "studio",
    "calibrate",
    "--resume",
    "http",
    "alpaca",
)
#: Commands that take a smaller picture here; the plain `camctl shoot` takes a whole one.
_PICTURES = ("shoot", "series", "preview")


def _computed(words: list[str]) -> tuple[str, ...]:
    """Return the part of a command that decides what is computed: without the file of a plot."""
    plot = words.index("--plot") if "--plot" in words else len(words)
    return (*words[:plot], *words[plot + 2 :])


#: The page that each command is run for: a study that two pages name takes long enough once.
_FIRST_PAGES = {_computed(words): name for name, words in reversed([*commands()])}


@pytest.mark.slow
@pytest.mark.timeout(1800)  # whole studies, which take long on a busy machine
@pytest.mark.parametrize("page", sorted({*_FIRST_PAGES.values()}))
def test_the_commands_of_a_page_work(
    page: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    own_profiles: Path,
) -> None:
    """In this process, where a warning is an error; `.ci/other-packages` starts programs."""
    monkeypatch.chdir(tmp_path)
    for name, columns in _FILES.items():
        np.savetxt(tmp_path / name, np.column_stack(columns))
    for name, source in (("my-street", "scenes/night-street"), ("my-sensor", "sensors/complete")):
        (tmp_path / f"{name}.json").write_bytes((ROOT / f"camctl/sim/{source}.json").read_bytes())
    for name, exposure in (("a", 0.25), ("b", 1.0), ("c", 4.0)):
        light = np.geomspace(0.003, 1, 64 * 48).reshape(48, 64) * exposure
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.minimum(256 * light**0.45, 255).astype("u1"))
    for number, (name, words) in enumerate(commands()):
        # A command that installs is run by .ci/run.
        if name != page or _FIRST_PAGES[_computed(words)] != page:
            continue
        if not words or any(w.startswith(_NEEDS_A_DEVICE) for w in words):
            continue
        if words == ["shoot"]:  # two captures in one second would have one name
            words = [*words, "-o", f"capture-{number}"]
        elif words[0] in _PICTURES and not re.search(r"-O|--camera|\.exr", " ".join(words)):
            words = [*words, "-O", "size=256x192"]
        if "--repeat" in words:  # a long series does the same again and again
            words[words.index("--repeat") + 1] = "4"
        if words[:2] == ["tradeoff", "capture"]:  # a study measures more and larger pictures alike
            words = [*words, "--size", "64x48", "--repeats", "1"]
            words += ["-n", "1,3"] if "-n" not in words else []
        capfd.readouterr()
        status = main(words)
        printed = capfd.readouterr()
        assert status == 0, f"{words}: {printed.err}"
        assert printed.out, words
