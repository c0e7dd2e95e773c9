"""Options that several commands share, and the kinds of value that they take."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import click
from click.core import ParameterSource

from camctl.errors import UsageError, unknown_name

if TYPE_CHECKING:
    from camctl.exposure.goal import NoiseTerm
    from camctl.exposure.response import RealResponse

    AnyType = click.ParamType[Any]
else:
    AnyType = click.ParamType  # generic only since click 8.3, and only for type checkers

Function = TypeVar("Function", bound=Callable[..., Any])
Decorator: TypeAlias = Callable[[Function], Function]

PATH = click.Path(path_type=Path)


class _Kind(AnyType):
    """A kind of value that says which option was off."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of the words; anything that is not text is a value already."""
        if not isinstance(value, str):
            return value
        option = param.opts[-1] if param is not None else "value"
        return self.read(value.strip(), option)

    def read(self, word: str, option: str) -> Any:
        """Return the value of `word`; raise `UsageError`."""
        raise NotImplementedError


def _number(word: str, option: str, what: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise UsageError(f"{option}: '{word}' is not {what}") from None
    if not math.isfinite(value):
        raise UsageError(f"{option}: {word} is not finite", hint=f"give {what}")
    return value


class Number(_Kind):
    """A finite number within bounds."""

    name = "number"

    def __init__(
        self,
        what: str = "a number",
        *,
        above: float = -math.inf,
        least: float = -math.inf,
        below: float = math.inf,
    ) -> None:
        self.what = what
        self._above, self._least, self._below = above, least, below

    def read(self, word: str, option: str) -> float:
        """Return the number."""
        value = _number(word, option, self.what)
        if not (self._above < value < self._below and value >= self._least):
            raise UsageError(f"{option}: {word} is not {self.what}")
        return value


class Whole(_Kind):
    """A whole number within bounds."""

    name = "integer"

    def __init__(self, what: str, *, least: int, most: int | None = None) -> None:
        self.what = what
        self._least, self._most = least, most

    def read(self, word: str, option: str) -> int:
        """Return the number."""
        try:
            value = int(word)
        except ValueError:
            raise UsageError(f"{option}: '{word}' is not {self.what}") from None
        if value < self._least or (self._most is not None and value > self._most):
            raise UsageError(f"{option}: {word} is not {self.what}")
        return value


class Name(_Kind):
    """One of a few names."""

    name = "name"

    def __init__(self, kind: str, names: Iterable[str]) -> None:
        self.kind = kind
        self.names = tuple(names)

    def read(self, word: str, option: str) -> str:
        """Return the name in the letters it is known by."""
        if word.lower() not in self.names:
            raise unknown_name(self.kind, word, self.names)
        return word.lower()


class Names(Name):
    """Several of a few names, parted by commas."""

    def read(self, word: str, option: str) -> Any:
        """Return the names as a tuple, each once."""
        words = [part.strip() for part in word.split(",")]
        return tuple(dict.fromkeys(super(Names, self).read(part, option) for part in words))


class Range(_Kind):
    """A dynamic range: low, medium, high, or a number above 1, also written 1:NUMBER."""

    name = "range"

    def read(self, word: str, option: str) -> float:
        """Return the dynamic range as a number."""
        from camctl.exposure.response import RANGES

        if word.lower() in RANGES:
            return RANGES[word.lower()]
        digits = word.removeprefix("1:").replace(",", "")
        try:
            value = float(digits)
        except ValueError:
            raise unknown_name("dynamic range", word, RANGES) from None
        if not (math.isfinite(value) and value > 1):
            raise UsageError(
                f"{option}: {word} is no dynamic range",
                hint="brightest over darkest, a finite number above 1",
            )
        return value


class Ranges(Range):
    """Several dynamic ranges, parted by commas."""

    def read(self, word: str, option: str) -> Any:
        """Return the dynamic ranges as a tuple, each once."""
        words = word.split(",")
        return tuple(dict.fromkeys(super(Ranges, self).read(w.strip(), option) for w in words))


class Ratios(_Kind):
    """Exposures relative to one another."""

    name = "ratios"

    def read(self, word: str, option: str) -> tuple[float, ...]:
        """Return the exposures, ascending and relative to the smallest."""
        values = []
        for part in word.replace(",", " ").split():
            value = _number(part, option, "a number")
            if value <= 0:
                raise UsageError(f"{option}: exposure {part} is not positive")
            values.append(value)
        if not values:
            raise UsageError(f"{option}: no exposures", hint="for example --ratios 1,2,4")
        return tuple(value / min(values) for value in sorted(values))


class Seconds(_Kind):
    """A shutter time: seconds, or a fraction as on a dial; optionally `auto` for none."""

    name = "seconds"

    def __init__(self, *, auto: bool = False) -> None:
        self._auto = auto

    def read(self, word: str, option: str) -> float | None:
        """Return the time in s; None for auto."""
        if self._auto and word.lower() == "auto":
            return None
        what = "a time in seconds such as 0.004 or 1/250" + (", or auto" if self._auto else "")
        above, _, under = word.partition("/")
        value = _number(above, option, what)
        if under:
            divisor = _number(under, option, what)
            value = value / divisor if divisor > 0 else -1.0
        if value <= 0:
            raise UsageError(f"{option}: {word} is not {what}")
        return value


class Size(_Kind):
    """Width x height."""

    name = "size"

    def read(self, word: str, option: str) -> str:
        """Return the size as WxH."""
        width, _, height = word.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
            raise UsageError(f"{option}: '{word}' is no size", hint="for example --size 640x480")
        return f"{int(width)}x{int(height)}"


RESPONSES = ("linear", "gamma", "log")

NOISE_KINDS = ("paper", "time", "aperture", "gain")

RESPONSE = Name("response", RESPONSES)

COUNT = Whole("a whole number of exposures, 1 to 16", least=1, most=16)


def all_of(*decorators: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return one decorator that adds the options of all, in this order."""

    def decorate(function: Any) -> Any:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


response = click.option(
    "--response",
    type=RESPONSE,
    default="log",
    metavar="linear|gamma|log",
    help="How brightness shall follow light; log gives equal contrast in shadows and highlights.",
)

dynamic_range = click.option(
    "--range",
    "dynamic_range",
    type=Range(),
    default="medium",
    metavar="low|medium|high|NUMBER",
    help="Brightest over darkest light to be told apart: 256, 1,000, 16,000, or any NUMBER.",
)

count = click.option(
    "-n",
    "--exposures",
    "count",
    type=COUNT,
    default=3,
    metavar="N",
    help="Number of exposures.",
)

levels_wanted = click.option(
    "--levels",
    "levels_wanted",
    type=Number("a positive number of levels", above=0),
    metavar="G",
    help="Brightness levels wanted in the picture.  [default: as many as the frames hold]",
)

seed = click.option(
    "--seed",
    type=Whole("a whole number from 0", least=0),
    default=0,
    metavar="N",
    help="Start of the random numbers; the same seed gives the same result.",
)

as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Write one JSON value to standard output and nothing else.",
)

real_camera = all_of(
    click.option(
        "--bits",
        type=Whole("a whole number of bits, 1 to 16", least=1, most=16),
        default=8,
        metavar="B",
        help="Bits a sample of the real camera.",
    ),
    click.option(
        "--phase",
        type=Number("a phase of at least 0 and below 1", least=0, below=1),
        default=0.0,
        metavar="PHI",
        help="Phase of its quantiser, in levels: 0 cuts off, 0.5 rounds.",
    ),
    click.option(
        "--curve",
        type=PATH,
        metavar="FILE",
        help="Its response: two columns, irradiance and brightness, both 0 to 1.  "
        "[default: linear]",
    ),
)


objective = all_of(
    click.option(
        "--p",
        type=Number("a number of at least 1", least=1),
        default=1.0,
        metavar="1|2",
        help="Power of the objective; only 1 counts missing levels.",
    ),
    click.option(
        "--noise",
        type=Number("a number from 0", least=0),
        metavar="SIGMA",
        help="Add what noise costs: its standard deviation at exposure 1, full scale being 1.",
    ),
    click.option(
        "--noise-weight",
        type=Number("a number from 0", least=0),
        default=1.0,
        metavar="C",
        help="What a squared full scale of noise costs, in levels.",
    ),
    click.option(
        "--noise-kind",
        type=Name("noise term", NOISE_KINDS),
        default="paper",
        metavar="|".join(NOISE_KINDS),
        help="How noise goes with exposure: as the paper has it, or as read noise does where "
        "exposure is shutter time, aperture or gain.",
    ),
    click.option(
        "--jitter",
        type=Number("a fraction from 0", least=0),
        default=0.0,
        metavar="FRACTION",
        help="Average over exposures that come out wrong by this fraction, for example 0.01.",
    ),
)


def noise_term(sigma: float | None, weight: float, kind: str) -> NoiseTerm | None:
    """Return the noise term that `objective`'s options describe."""
    from camctl.exposure.goal import NoiseTerm

    return None if sigma is None else NoiseTerm(sigma, weight, kind)


def given(context: click.Context) -> set[str]:
    """Return the names of the parameters that the user gave."""
    return {
        name
        for name in context.params
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }


def spelling(context: click.Context, name: str) -> str:
    """Return how a parameter is spelt on the command line."""
    return next(each.opts[-1] for each in context.command.params if each.name == name)


def real_response(bits: int, phase: float, curve: Path | None) -> RealResponse:
    """Return the camera that `real_camera`'s options describe."""
    from camctl.exposure.response import linear_response, read_curve

    if curve is None:
        return linear_response(bits, phase=phase)
    return read_curve(curve, bits=bits, phase=phase)


camera = click.option(
    "--camera",
    "camera_id",
    default="sim",
    metavar="ID",
    help="Which camera; `camctl cameras` lists the ids.",
)

scene = click.option(
    "--scene",
    metavar="NAME|FILE",
    help="What the simulated camera looks at: a built-in scene, or a radiance map "
    "(.hdr, .exr, .tiff, .npy).  [default: tile-floor]",
)

sensor = click.option(
    "--sensor",
    metavar="NAME|FILE.json",
    help="The sensor of the simulated camera.  [default: standard]",
)

size = click.option(
    "--size",
    type=Size(),
    metavar="WxH",
    help="Pixels of the simulated camera.  [default: the sensor's, or the map's]",
)

noise_seed = click.option(
    "--seed",
    type=Whole("a whole number from 0", least=0),
    metavar="N",
    help="Start of the simulated noise; the same seed gives the same frames.  [default: 0]",
)

simulation = all_of(
    scene,
    sensor,
    size,
    noise_seed,
    click.option(
        "--real-time",
        is_flag=True,
        help="Let the simulated camera take as long as a real one would.",
    ),
)

shooting = all_of(
    click.option(
        "--mains",
        type=Name("mains frequency", ("50", "60")),
        metavar="50|60",
        help="Lamps on mains of that many Hz: prefer whole flicker periods.",
    ),
    click.option(
        "--aperture",
        "use_aperture",
        is_flag=True,
        help="Let the aperture take part where time and gain do not reach.",
    ),
    click.option(
        "--meter",
        "spend_shutter",
        is_flag=True,
        help="Meter with full exposures on a camera that has no preview.",
    ),
)


def camera_options(
    scene: str | None = None,
    sensor: str | None = None,
    size: str | None = None,
    seed: int | None = None,
    *,
    real_time: bool = False,
) -> dict[str, str]:
    """Return, as words, the options for the camera that the user gave."""
    words = {
        "scene": scene,
        "sensor": sensor,
        "size": size,
        "seed": seed,
        "time": "real" if real_time else None,
    }
    return {name: str(word) for name, word in words.items() if word is not None}
