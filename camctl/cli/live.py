"""`camctl live`: the effective camera as a page, a webcam, a pipe or files."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import (
    format_duration,
    format_fields,
    format_number,
    print_error,
    print_finding,
    print_json,
    print_text,
)
from camctl.cli.parameter_types import Number, WholeNumber
from camctl.cli.request_options import WITH_LIGHT, RequestOptions, request_options
from camctl.errors import CameraError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from camctl.findings import Finding
    from camctl.livestream.outputs import Output
    from camctl.livestream.result import LiveResult
    from camctl.livestream.stream import Live

_REQUEST = (
    "response",
    "gamma",
    "dynamic_range",
    "clip_percent",
    "count",
    "accuracy",
    "ratios",
    "base_s",
    "compensation_stops",
)
_OUTPUTS = "http[:[HOST:]PORT], v4l2:/dev/videoN, - (Y4M), raw:- (16 bits) or exr:FOLDER"
#: The search by accuracy takes about a second for a range, in which the light changes.
_RANGE = replace(
    WITH_LIGHT["dynamic_range"],
    help="Dynamic range of the picture, brightest over darkest light: 256, 1,000, 16,000, or any "
    "NUMBER; auto follows the scene among these three, whose exposures are in a table, or with "
    "--set objective=accuracy among all stops if the camera's noise is known.  [default: auto]",
)
#: Results whose latency is stated: of half a minute at 30 a second.
_RATED = 900


@command(
    examples=(
        ("camctl live --scene moving-target --output http", "the simulated camera in a page"),
        ("camctl live --camera v4l2:/dev/video0 --fps 15 --output v4l2:/dev/video9", "as a webcam"),
        ("camctl live --output - | ffmpeg -i - -t 10 live.mkv", "ten seconds as a video"),
        ("camctl live --output exr:frames --every 30 --count 300", "each 30th result as a file"),
    )
)
@options.camera_options
@request_options(*_REQUEST, "settings", has_light=True, dynamic_range=_RANGE)
@option(
    "--fps RATE",
    "Results a second at least, which limits the exposures.  [default: 10, or as many as the "
    "camera has]",
    Number("a rate from 0.01 to 10000", least=0.01, most=10_000),
)
@option(
    "--output OUTPUT",
    f"Where the results go: {_OUTPUTS}; may be given several times.",
    field="outputs",
    kind=click.STRING,
    multiple=True,
    required=True,
)
@option("--look", "Show a tone-mapped picture instead of the desired response.")
@option("--every K", "Write each K-th result to exr:FOLDER.", WholeNumber(least=1), default=1)
@option("--count N", "End after so many results.", WholeNumber(least=1), field="most")
@options.as_json
def live(
    camera: CameraOptions,
    request: RequestOptions,
    fps: float | None,
    outputs: tuple[str, ...],
    look: bool,
    every: int,
    most: int | None,
    as_json: bool,
) -> None:
    """Show the effective camera live: each frame completes a picture.

    The camera repeats the exposures of a plan without a pause. The last frames of all exposures
    make a result, one for each new frame, and exposures follow the light. A page (http) shows the
    picture, a histogram and the exposures; other programs read it as a webcam (v4l2, with the
    kernel module v4l2loopback), as MJPEG from /video of the page, from a pipe, or as OpenEXR files.
    Ends with Ctrl-C.
    """
    from camctl.livestream.stream import live as begin

    if request.table is not None:
        raise UsageError("a live camera has no table of exposures", hint="leave --set table= out")
    piped = [each for each in outputs if each in ("-", "raw:-")]
    is_piped = bool(piped)
    if len(piped) > 1:
        raise UsageError(
            f"--output {piped[0]} and --output {piped[1]} would be mixed in one pipe",
            hint="leave one of them out",
        )
    if as_json and is_piped:
        raise UsageError("--json cannot be combined with --output -", hint="leave one of them out")
    wanted = request.request()
    makers = [_maker(each, look=look, every=every) for each in outputs]
    with ExitStack() as resources:
        opened = resources.enter_context(camera.in_real_time().open())
        # Files are complete; who looks wants the newest.
        policy: Any = "all" if any(each.startswith("exr:") for each in outputs) else "latest"
        results = begin(opened, wanted, fps=fps, policy=policy, reuse=True)
        resources.enter_context(results)
        takers = []
        for maker in makers:
            takers.append(maker(results))
            resources.callback(takers[-1].close)
        run = _Run(results)
        results.on_waiting = _say_waiting
        try:
            for result in results:
                for taker in takers:
                    taker.write(result)
                if not run.count:  # all outputs take results
                    _say_addresses(takers)
                run.add(result)
                if run.count == most:
                    break
        except BrokenPipeError:
            pass  # the program that read has ended
        except KeyboardInterrupt:  # as it ends where nobody says how many results
            if run.count and not as_json and not is_piped:
                print_text(run.text())
            raise
        if as_json:
            print_json(run.json())
        elif not is_piped:
            print_text(run.text())


def _maker(text: str, *, look: bool, every: int) -> Callable[[Live], Output]:
    """Return what opens the output that an option names, for a stream; `UsageError`: none."""
    from camctl.livestream.display import Display
    from camctl.livestream.outputs import ExrOutput, RawOutput, Y4mOutput

    kind, _, rest = text.partition(":")
    if kind == "http":
        from camctl.livestream.web import PAGE_PIXELS, WebOutput, live_site
        from camctl.system.web_server import DEFAULT_PORT

        site = live_site(rest or str(DEFAULT_PORT))
        return lambda live: WebOutput(live, site, Display(look=look, most=PAGE_PIXELS))
    if kind == "v4l2" and rest:
        return lambda _: _Loopback(rest, Display(look=look))
    if text == "-":
        return lambda live: Y4mOutput(sys.stdout.buffer, Display(look=look), live)
    if text == "raw:-":
        return lambda _: RawOutput(sys.stdout.buffer)
    if kind == "exr" and rest:
        return lambda _: ExrOutput(Path(rest), every)
    raise UsageError(f"unknown output {text!r}", hint=f"use {_OUTPUTS}")


def _say_addresses(takers: Iterable[Output]) -> None:
    """Print where pages are served."""
    from camctl.livestream.web import WebOutput

    for taker in takers:
        if isinstance(taker, WebOutput):
            print_error(f"live at {taker.site.shown_url}")


def _say_waiting(error: CameraError | None) -> None:
    """Print that the camera is waited for, or that it is back."""
    print_error(
        "the camera is back" if error is None else f"{error.what}: waiting until it is back"
    )


class _Loopback:
    """A webcam for other programs; opened with the first result, which has the size."""

    def __init__(self, path: str, display: Any) -> None:
        self._path, self._display = path, display
        self._device: Any = None

    def write(self, result: LiveResult) -> None:
        """Show a result."""
        from camctl.drivers.v4l2.loopback import LoopbackDevice
        from camctl.livestream.outputs import ycbcr

        picture = self._display.picture(result)
        if picture.ndim == 3:
            picture = ycbcr(picture)
        if self._device is None:
            self._device = LoopbackDevice(self._path, picture.shape[:2])
        self._device.write(picture)

    def close(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.close()


class _Run:
    """What is stated of a stream at its end."""

    def __init__(self, results: Live) -> None:
        self._results = results
        self.count = 0
        self._began = time.perf_counter()
        self._latencies: list[float] = []
        self._last: LiveResult | None = None
        self._said: set[str] = set()

    def add(self, result: LiveResult) -> None:
        """Count a result."""
        self.count += 1
        self._last = result
        self.say(result.findings)
        self._latencies = [*self._latencies[1 - _RATED :], result.latency_s]

    def say(self, findings: Iterable[Finding]) -> None:
        """Print the findings whose code has not been printed yet."""
        for finding in findings:
            if finding.code not in self._said:
                self._said.add(finding.code)
                print_finding(finding)

    def json(self) -> dict[str, Any]:
        """Return it for --json."""
        last, seconds = self._last, time.perf_counter() - self._began
        latencies = sorted(self._latencies)
        return {
            "results": self.count,
            "seconds": seconds,
            "results_per_second": self.count / seconds,
            "lost": self._results.lost,
            "latency_s": latencies[len(latencies) // 2] if latencies else None,
            "age_s": None if last is None else last.age_s,
            "exposures_s": [] if last is None else [each.setting.time_s for each in last.exposures],
            "dynamic_range": None if last is None else last.plan.dynamic_range,
            "findings": () if last is None else last.findings,
        }

    def text(self) -> str:
        """Return it for people."""
        found = self.json()
        latency, age = found["latency_s"], found["age_s"]
        fields = [
            ("results", f"{self.count}, {format_number(found['results_per_second'], 3)} a second"),
            ("exposures", ", ".join(map(format_duration, found["exposures_s"]))),
            ("latency", "" if latency is None else format_duration(latency)),
            ("lag", "" if age is None else f"up to {format_duration(age)} where things move"),
            ("frames lost", str(found["lost"])),
        ]
        return format_fields(fields)
