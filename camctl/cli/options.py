"""Options that several commands share, and what their values mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from camctl.cli.parameters import Name, NameOrFile, Number, Range, Size, Whole, Word
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.exposure.noise import NoiseTerm
    from camctl.response.desired import DesiredResponse

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

wish = click.option(
    "--response",
    type=NameOrFile("response", RESPONSES),
    default="log",
    metavar="linear|gamma|log|FILE",
    help="How brightness shall follow light; log gives equal contrast in shadows and highlights. A "
    "file has two columns, irradiance and brightness, and brings its own range.",
)

exponent = click.option(
    "--gamma",
    "exponent",
    type=Number("an exponent from 0.01 to 100", least=0.01),
    metavar="Q",
    help="Exponent of --response gamma: brightness goes with light^Q.  [default: 0.5]",
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

objective = all_of(
    click.option(
        "--p",
        type=Number("a number of at least 1", least=1),
        default=1.0,
        show_default="1",
        metavar="P",
        help="Power of the objective, 1 to 16; only 1 counts missing levels.",
    ),
    click.option(
        "--noise",
        type=Number("a number from 0", least=0),
        metavar="SIGMA",
        help="Add what noise costs: its standard deviation at exposure 1, full scale being 1.  "
        "[default: not added]",
    ),
    click.option(
        "--noise-weight",
        type=Number("a number from 0", least=0),
        default=1.0,
        show_default="1",
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
        show_default="0",
        metavar="FRACTION",
        help="Average over exposures that come out wrong by this fraction, up to 0.2; for example "
        "0.01.",
    ),
)


def desired(response: str, dynamic_range: float, exponent: float | None) -> DesiredResponse:
    """Return the wanted response that `response`, `dynamic_range` and `exponent` describe."""
    from camctl.response.desired import desired_response
    from camctl.response.measured import read_desired

    if response not in RESPONSES:
        if given(click.get_current_context()) & {"dynamic_range", "exponent"}:
            raise UsageError(
                f"{response} brings its own range", hint="leave out --range and --gamma"
            )
        return read_desired(response)
    if exponent is None:
        return desired_response(response, dynamic_range)
    if response != "gamma":
        raise UsageError(f"--gamma goes without --response {response}", hint="say --response gamma")
    return desired_response(response, dynamic_range, gamma=exponent)


def noise_term(sigma: float | None, weight: float, kind: str) -> NoiseTerm | None:
    """Return the noise term that `objective`'s options describe."""
    from camctl.exposure.noise import NoiseTerm

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
    help="Pixels of a frame.  [default: the sensor's, or the map's]",
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

camera_words = click.option(
    "-O",
    "--camera-option",
    "words",
    type=Word(),
    multiple=True,
    metavar="NAME=VALUE",
    help="An option of the camera's own, such as format=y16; may be given several times.",
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
    words: Sequence[tuple[str, str]] = (),
    *,
    scene: str | None = None,
    sensor: str | None = None,
    size: str | None = None,
    seed: int | None = None,
    real_time: bool = False,
    tolerance_dn: float | None = None,
) -> dict[str, str]:
    """Return the options for the camera that the user gave: those of their own names, and `words`.

    Raises:
        UsageError: one is said twice
    """
    named = {
        "scene": scene,
        "sensor": sensor,
        "size": size,
        "seed": seed,
        "time": "real" if real_time else None,
        "tolerance": tolerance_dn,
    }
    said = {name: str(word) for name, word in named.items() if word is not None}
    for name, value in words:
        if name in said:
            raise UsageError(f"the camera's option '{name}' is said twice", hint="say it once")
        said[name] = value
    return said
