"""Options that several commands share; options that belong together arrive as one dataclass."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from camctl.cli.parameter_types import (
    CAMERA,
    PATH,
    SCENE,
    SENSOR,
    FrameSize,
    KeyValue,
    Name,
    Number,
    WholeNumber,
)
from camctl.errors import UsageError
from camctl.exposure.goal import DEFAULT_COUNT

if TYPE_CHECKING:
    from camctl.interface.camera import Camera

Decorator = Callable[[Any], Any]


def all_of(*decorators: Decorator) -> Decorator:
    """Return one decorator that applies all, so that their options are listed in this order."""

    def decorate(function: Any) -> Any:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


def option_group(model: type[Any], name: str, *options: Decorator) -> Decorator:
    """Return a decorator that adds options to a command and passes their values as one argument.

    Args:
        model: a dataclass with one field for each option, of the same name
        name: of the command's argument that receives the instance
        options: decorators made by `click.option`
    """

    def decorate(function: Any) -> Any:
        @functools.wraps(function)
        def call(*arguments: Any, **values: Any) -> Any:
            names = [field.name for field in fields(model) if field.name in values]
            group = model(**{each: values.pop(each) for each in names})
            return function(*arguments, **{name: group}, **values)

        return all_of(*options)(call)

    return decorate


def given(context: click.Context) -> set[str]:
    """Return the names of the parameters that were given on the command line."""
    return {
        name
        for name in context.params
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }


def option_name(context: click.Context, parameter: str) -> str:
    """Return the long name of a parameter's option, such as --range."""
    return next(each.opts[-1] for each in context.command.params if each.name == parameter)


def refuse_together(
    context: click.Context, option: str, others: set[str], hint: str = "leave one of them out"
) -> None:
    """Raise `UsageError` if one of the parameters `others` was given beside `option`."""
    if conflicts := sorted(option_name(context, name) for name in others & given(context)):
        raise UsageError(f"{option} cannot be combined with {', '.join(conflicts)}", hint=hint)


COUNT = WholeNumber(least=1, most=16)

count = click.option(
    "-n",
    "--exposures",
    "count",
    type=COUNT,
    default=DEFAULT_COUNT,
    metavar="N",
    help="Number of exposures.",
)

objective_kind = click.option(
    "--objective",
    "objective_kind",
    type=Name("objective", ("xi", "accuracy")),
    metavar="xi|accuracy",
    help="Choose exposures by the levels that they miss (xi), or by the least predicted error with "
    "the camera's noise (accuracy): of sets within 0.5 % of the most effective levels the one of "
    "least time.",
)

accuracy = click.option(
    "--accuracy",
    type=Number("a number of effective levels from 1", least=1),
    metavar="LEVELS",
    help="Reach so many effective levels, noise included, in the least time; with as many "
    "exposures as that needs, up to 6, unless -n is given.",
)

seed = click.option(
    "--seed",
    type=WholeNumber(least=0),
    default=0,
    metavar="N",
    help="Seed of the random numbers; the same seed gives the same result.",
)

as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Write one JSON value to standard output and nothing else.",
)

force = click.option("--force", is_flag=True, help="Replace existing files.")


def result_folder(kind: str) -> Decorator:
    """Return -o and --force of a command whose result is a folder of this kind."""
    return all_of(
        click.option(
            "-o",
            "--output",
            "directory",
            type=PATH,
            metavar="PATH",
            help=f"Folder for the result.  [default: {kind}-DATE-TIME in the working directory]",
        ),
        click.option("--force", is_flag=True, help="Replace an earlier capture in that folder."),
    )


@dataclass(frozen=True)
class SceneOptions:
    """What the simulated camera looks at, and with which sensor; None is the default."""

    scene: str | None
    sensor: str | None
    size: str | None
    seed: int | None
    faults: str | None = None

    def camera_options(self) -> dict[str, Any]:
        """Return those that were given, by their names as options of the simulated camera."""
        values = {field.name: getattr(self, field.name) for field in fields(SceneOptions)}
        return {name: value for name, value in values.items() if value is not None}


def scene_options(default_sensor: str | None = None) -> Decorator:
    """Return the options of `SceneOptions`; their argument is called `scenery`."""
    return option_group(
        SceneOptions,
        "scenery",
        click.option(
            "--scene",
            type=SCENE,
            metavar="NAME|FILE",
            help="Scene before the simulated camera: a built-in one or a radiance map "
            "(.hdr, .exr, .tiff, .npy).  [default: tile-floor]",
        ),
        click.option(
            "--sensor",
            type=SENSOR,
            default=default_sensor,
            metavar="NAME|FILE.json",
            help="Sensor of the simulated camera."
            + ("" if default_sensor else "  [default: standard]"),
        ),
        click.option(
            "--size",
            type=FrameSize(),
            metavar="WIDTHxHEIGHT",
            help="Size of a frame in pixels.  [default: the sensor's, or the radiance map's]",
        ),
        click.option(
            "--seed",
            type=WholeNumber(least=0),
            metavar="N",
            help="Seed of the simulated noise; the same seed gives the same frames.  [default: 0]",
        ),
        click.option(
            "--fault",
            "faults",
            metavar="FAULT,...",
            help="Faults of the simulated camera, such as unplug@3 or wrong@1=0.5 (see "
            "docs/how-to/ci.md).  [default: none]",
        ),
    )


camera_settings = click.option(
    "-O",
    "--camera-option",
    "camera_settings",
    type=KeyValue(),
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of this kind of camera, such as format=y16; may be given several times.",
)

no_profile = click.option(
    "--no-profile",
    is_flag=True,
    help="Leave out what calibrations of this camera have measured; the same as -O profile=none.",
)


@dataclass(frozen=True)
class CameraOptions:
    """Which camera to open, and the options to open it with."""

    camera_id: str
    camera_settings: tuple[tuple[str, str], ...]
    scenery: SceneOptions
    real_time: bool
    no_profile: bool = False
    simulation_tolerance: float | None = None

    def camera_options(self) -> dict[str, str]:
        """Return the camera's options by name; raise `UsageError` where one is given twice."""
        simulation = self.scenery.camera_options()
        if self.real_time:
            simulation["time"] = "real"
        if self.simulation_tolerance is not None:
            simulation["tolerance"] = self.simulation_tolerance
        options = {name: str(value) for name, value in simulation.items()}
        for name, value in self.camera_settings:
            if name in options:
                raise UsageError(f"camera option '{name}' is given twice", hint="give it once")
            options[name] = value
        if self.no_profile:
            options["profile"] = "none"
        return options

    def open(self, *, profile: str = "all") -> Camera:
        """Open the camera, with these parts of its profile unless the user names others."""
        from camctl.profiles.calibrated import open_camera

        return open_camera(self.camera_id, {"profile": profile, **self.camera_options()})

    def unused_faults(self, camera: Camera) -> str | None:
        """Return which of the faults asked for did not happen, if there are any."""
        unused = getattr(camera, "unused_faults", []) if self.scenery.faults else []
        if not unused:
            return None
        return f"these faults did not happen, since fewer frames were taken: {', '.join(unused)}"

    def source(self) -> dict[str, Any]:
        """Return what a report must hold to open the camera again from any working directory.

        Raises:
            UsageError: a name cannot be written to a report
        """
        options = {name: _absolute(value) for name, value in self.camera_options().items()}
        options.pop("faults", None)  # they would come again in a resumed capture
        for name, value in options.items():
            if value != value.encode("utf-8", "replace").decode():
                raise UsageError(
                    f"{name} {value} is not UTF-8, and a report cannot hold it",
                    hint="rename the file",
                )
        return {"camera": self.camera_id, "options": options}


def _absolute(value: str) -> str:
    """Return a file's full path; a name without dot and slash stays, even if a file has it."""
    path = Path(value)
    return str(path.resolve()) if (path.suffix or "/" in value) and path.exists() else value


camera_options = option_group(
    CameraOptions,
    "camera",
    click.option(
        "--camera",
        "camera_id",
        type=CAMERA,
        default="sim",
        metavar="ID",
        help="Camera; `camctl cameras` lists the ids.",
    ),
    camera_settings,
    scene_options(),
    click.option(
        "--real-time",
        is_flag=True,
        help="Let the simulated camera take as long as a real one would.",
    ),
    no_profile,
)


CAMERA_PARAMETERS = {
    field.name for model in (CameraOptions, SceneOptions) for field in fields(model)
}
"""Names of the parameters that say which camera is opened, and how."""
