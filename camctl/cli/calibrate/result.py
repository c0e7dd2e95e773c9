"""What the calibrations share: frames taken before, and how a result is printed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from camctl.cli import options, output
from camctl.cli.options import CameraOptions, declare_as, option_group
from camctl.cli.parameter_types import PATH

if TYPE_CHECKING:
    from camctl.calibration.results import Result

    ResultT = TypeVar("ResultT", bound=Result)

Rows = Iterable[tuple[str, str]]


@dataclass(frozen=True)
class SeriesOptions:
    """Frames that were taken before, in place of a camera."""

    files: tuple[Path, ...] = declare_as(
        click.argument("files", type=PATH, nargs=-1, metavar="[FILES]...")
    )
    times: tuple[float, ...] | None = declare_as(options.TIMES_OPTION)
    black: int | None = declare_as(options.BLACK_OPTION)
    white: int | None = declare_as(options.WHITE_OPTION)

    def check(self, alone: Collection[str]) -> None:
        """Raise `UsageError` where options of a camera are given beside FILES, or the reverse.

        Args:
            alone: parameters of the command that belong to a camera
        """
        context = click.get_current_context()
        names = options.given(context)
        if self.files:
            options.refuse_together(context, "FILES", names & {*options.CAMERA_PARAMETERS, *alone})
        else:
            hint = "name the files, or leave it out"
            options.refuse_together(context, "--camera", names & {"times", "black", "white"}, hint)


series_options = option_group(SeriesOptions, "source")


def measured(
    function: Callable[..., ResultT],
    camera: CameraOptions,
    label: str,
    *,
    profile: str = "none",
    source: SeriesOptions | None = None,
    how: dict[str, Any] | None = None,
    **of_camera: Any,
) -> ResultT:
    """Return what a function of `camctl.calibrate` measures of frames, else of the camera.

    Args:
        function: of `camctl.calibrate`
        camera: which one
        label: of the progress bar
        profile: parts of the camera's profile that are used
        source: the frames; the camera is measured where there are none
        how: arguments for both
        of_camera: arguments for a camera
    """
    how = how or {}
    if source is not None and source.files:
        levels = {"black": source.black, "white": source.white}
        return function(source.files, source.times, **levels, **how)
    with camera.open(profile=profile) as opened, output.progress_bar(label) as bar:
        return function(opened, progress=output.without_stage(bar), **how, **of_camera)


def show(result: Result, text: Callable[[], tuple[str, Rows]], *, as_json: bool) -> None:
    """Print the findings of a result, and the result with its camera and its file.

    Args:
        result: what was measured
        text: returns a table, which may be empty, and rows
        as_json: print the result as JSON
    """
    for finding in result.findings:
        output.print_finding(finding)
    if as_json:
        output.print_json(result)
        return
    table, rows = text()
    info = result.camera
    own = [] if info is None else [("camera", output.camera_text(info))]
    own += [("mode", result.mode)] if info is not None and result.mode else []
    kept = [] if result.file is None else [("profile", str(result.file))]
    fields = output.format_fields([*rows, *own, *kept])
    output.print_text(f"{table}\n\n{fields}" if table else fields)
