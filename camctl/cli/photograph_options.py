"""Options of the commands that read photographs."""

from __future__ import annotations

import click

from camctl.cli.parameter_types import ListOf, Seconds, WholeNumber

TIMES_OPTION = click.option(
    "--times",
    type=ListOf(Seconds()),
    metavar="SECONDS,...",
    help="Shutter time of each of FILES, such as 1/30,1/15,1/8.  [default: from their EXIF data]",
)
BLACK_OPTION = click.option(
    "--black",
    type=WholeNumber(least=0, most=65534),
    metavar="DN",
    help="Black level of FILES.  [default: stated in raw files, else from the pixels]",
)
WHITE_OPTION = click.option(
    "--white",
    type=WholeNumber(least=1, most=65535),
    metavar="DN",
    help="White level of FILES, such as 4095 for 12 bits in 16-bit files.  "
    "[default: stated in raw files, else from the pixels]",
)
