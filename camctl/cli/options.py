"""Options that several commands share; options that belong together arrive as one dataclass."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from camctl.cli.parameter_types import (
    CAMERA,
    PATH,
    SCENE,
    SENSOR,
    AnyType,
    KeyValue,
    ListOf,
    Seconds,
    WholeNumber,
)
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.interface.camera import Camera

Decorator = Callable[[Any], Any]


def option(
    names: str, text: str, kind: AnyType | None = None, *, field: str = "", **more: Any
) -> Decorator:
    """Return a decorator that adds one option to a command.

    Args:
        names: its names and what stands for its value, as on the help page: "-o --output FILE"
        text: its help
        kind: parses the value; None: the option is a flag
        field: the command's argument that receives the value; "": named as the option
        more: other arguments of `click.option`
    """
    words = names.split()
    flags = [word for word in words if word.startswith("-")]
    if kind is None:
        more["is_flag"] = True
    return click.option(
        *flags,
        *filter(None, [field]),
        type=kind,
        metavar=" ".join(words[len(flags) :]) or None,
        help=text,
        **more,
    )


def all_of(*decorators: Decorator) -> Decorator:
    """Return one decorator that applies all, so that their options are listed in this order."""

    def decorate(function: Any) -> Any:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


class _Declared:
    """An option as the default of a dataclass's field; `make` gets the name of the field."""

    def __init__(self, make: Callable[[str], Decorator]) -> None:
        self.make = make


def declare(names: str, text: str, kind: AnyType | None = None, **more: Any) -> Any:
    """Return the option of a field of a dataclass for `option_group`; arguments as of `option`."""
    return _Declared(lambda field: option(names, text, kind, field=field, **more))


def declare_as(decorator: Decorator) -> Any:
    """Return the same for a decorator made by `click.option`, whose argument has the field's name.

    The type is `Any`, so that it fits any field.
    """
    return _Declared(lambda _field: decorator)


def option_group(model: type[Any], name: str, **instead: Any) -> Decorator:
    """Return a decorator that adds options to a command and passes their values as one argument.

    Args:
        model: a dataclass whose fields are options, in the order of the help page: see `declare`
        name: of the command's argument that receives the instance
        instead: options that take the place of those in the fields of these names
    """
    defaults = {each.name: instead.get(each.name, each.default) for each in fields(model)}
    declared = {field: default.make(field) for field, default in defaults.items()}

    def decorate(function: Any) -> Any:
        @functools.wraps(function)
        def call(*arguments: Any, **values: Any) -> Any:
            group = model(**{each: values.pop(each) for each in declared})
            return function(*arguments, **{name: group}, **values)

        return all_of(*declared.values())(call)

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


seed = option(
    "--seed N",
    "Seed of the random numbers; the same seed gives the same result.",
    WholeNumber(least=0),
    default=0,
)

as_json = option(
    "--json", "Write one JSON value to standard output and nothing else.", field="as_json"
)

TIMES_OPTION = option(
    "--times SECONDS,...",
    "Shutter time of each of FILES, such as 1/30,1/15,1/8.  [default: from their EXIF data]",
    ListOf(Seconds()),
)
DIAL_TIMES_OPTION = option(
    "--times SECONDS,...",
    "Shutter time of each of FILES: exact as numbers such as 0.033, nominal shutter speeds as "
    "fractions such as 1/30,1/15.  [default: from their EXIF data]",
    ListOf(Seconds(fractions=True)),
)
BLACK_OPTION = option(
    "--black DN",
    "Black level of FILES.  [default: stated in raw files, else from the pixels]",
    WholeNumber(least=0, most=65534),
)
WHITE_OPTION = option(
    "--white DN",
    "White level of FILES, such as 4095 for 12 bits in 16-bit files.  "
    "[default: stated in raw files, else from the pixels]",
    WholeNumber(least=1, most=65535),
)


def longest(
    help_text: str = "Longest shutter time to use.", default: str | None = "2"
) -> Decorator:
    """Return --longest of a command that measures a camera."""
    return option("--longest SECONDS", help_text, Seconds(), field="longest_s", default=default)


force = option("--force", "Replace existing files.")


def result_folder(kind: str) -> Decorator:
    """Return -o and --force of a command whose result is a folder of this kind."""
    return all_of(
        option(
            "-o --output PATH",
            f"Folder for the result.  [default: {kind}-DATE-TIME in the working directory]",
            PATH,
            field="directory",
        ),
        option("--force", "Replace an earlier capture in that folder."),
    )


def scene_option() -> Decorator:
    """Return --scene."""
    return option(
        "--scene NAME|FILE",
        "Scene before the simulated camera: a built-in one or a radiance map "
        "(.hdr, .exr, .tiff, .npy).  [default: tile-floor]",
        SCENE,
    )


def sensor_option(default: str = "standard") -> Decorator:
    """Return --sensor of the simulated camera."""
    return option(
        "--sensor NAME|FILE.json", f"Sensor of the simulated camera.  [default: {default}]", SENSOR
    )


camera_settings = option(
    "-O --camera-option NAME=VALUE",
    "Option of this kind of camera, such as format=y16; may be given several times: "
    "profile=none leaves out what calibrations have measured; the simulated camera has "
    "size=WIDTHxHEIGHT, seed=N, time=real, tolerance=DN, stream=NAME and faults=FAULT,...",
    KeyValue(),
    field="camera_settings",
    multiple=True,
)


def _simulated_or(context: click.Context, parameter: click.Parameter, value: str) -> str:
    """Return the camera: a scene or sensor on the command line asks for the simulated one."""
    is_given = context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE
    asks = {"scene", "sensor"} & given(context)
    return "sim" if asks and not is_given else value


@dataclass(frozen=True)
class CameraOptions:
    """Which camera to open, and the options to open it with."""

    camera_id: str = declare(
        "--camera ID",
        "Camera; `camctl cameras` lists the ids.  [default: $CAMCTL_CAMERA, else sim]",
        CAMERA,
        default="sim",
        envvar="CAMCTL_CAMERA",
        show_default=False,
        callback=_simulated_or,
    )
    camera_settings: tuple[tuple[str, str], ...] = declare_as(camera_settings)
    scene: str | None = declare_as(scene_option())
    sensor: str | None = declare_as(sensor_option())

    def camera_options(self) -> dict[str, str]:
        """Return the camera's options by name; raise `UsageError` where one is given twice."""
        named = {"scene": self.scene, "sensor": self.sensor}
        options = {name: value for name, value in named.items() if value is not None}
        for name, value in self.camera_settings:
            if name in options:
                raise UsageError(f"camera option '{name}' is given twice", hint="give it once")
            options[name] = value
        return options

    def open(self, *, profile: str = "all") -> Camera:
        """Open the camera, with these parts of its profile unless the user names others."""
        from camctl.profiles.calibrated import open_camera

        return open_camera(self.camera_id, {"profile": profile, **self.camera_options()})

    def in_real_time(self) -> CameraOptions:
        """Return these options with a simulated camera that waits, as others do."""
        is_simulated = self.camera_id.rpartition("effective:")[2].partition(":")[0] == "sim"
        if not is_simulated or "time" in self.camera_options():
            return self
        return replace(self, camera_settings=(*self.camera_settings, ("time", "real")))

    def unused_faults(self, camera: Camera) -> str | None:
        """Return which of the faults asked for did not happen, if there are any."""
        unused = getattr(camera, "unused_faults", ()) if "faults" in self.camera_options() else ()
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


camera_options = option_group(CameraOptions, "camera")

CAMERA_PARAMETERS = {each.name for each in fields(CameraOptions)}
"""Names of the parameters that say which camera is opened, and how."""
