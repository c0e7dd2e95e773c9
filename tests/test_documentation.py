"""The README and the documentation pages: examples run, commands exist, links lead somewhere."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
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
                        yield page.name, words[1:]


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
    assert int(printed[1].removeprefix("effective levels ")) > 100
    assert "(768, 1024, 3)" in printed[2]
    assert {path.name for path in (tmp_path / "room").iterdir()} >= {"radiance.exr", "report.json"}


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page: Path) -> None:
    missing = [
        target
        for target in _LINK.findall(page.read_text("utf-8"))
        if not (page.parent / target).exists()
    ]
    assert missing == []
