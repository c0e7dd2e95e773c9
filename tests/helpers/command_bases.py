"""Every command of the command line, and lines of each that work and are quick."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from camctl.cli import cli

BASES = {
    "shoot": (
        "--scene uniform -O size=16x12 -o out -n 2 --force",
        "-O size=9x7 --base 0.01",
    ),
    "series": ("--scene uniform -O size=9x7 --base 0.01 -n 1 --repeat 1",),
    "live": ("--scene uniform -O size=9x7 --base 0.01 -n 1 --count 1 --output exr:live",),
    "alpaca": ("--scene uniform -O size=16x12 --address nowhere",),
    "preview": ("--scene uniform -O size=16x12 -n 1 -o p.png --force",),
    "resume": ("nothing",),
    "merge": ("p0.png p1.png p2.png --times 1/8,1/2,2 --curve power:2.222 -o out --force",),
    "menu": ("--scene uniform -O size=16x12",),
    "studio": ("--scene uniform -O size=16x12 --address nowhere",),
    "cameras": ("",),
    "calibrate all": ("--scene uniform -O size=16x12 --longest 0.01 -O unknown=yes",),
    "calibrate colour": ("--scene colour-chart --sensor webcam -O size=320x240 -n 3",),
    "calibrate delay": ("--scene uniform -O size=16x12 --trials 2",),
    "profile list": ("",),
    "profile show": ("nothing",),
    "profile export": ("nothing",),
    "profile import": ("nothing",),
    "profile remove": ("nothing",),
    "simulate": ("--scene uniform --size 16x12", "--sensor standard --size 16x12 --times 0.1,1"),
    "solve": (
        "-n 2 --bits 3",
        "-n 2 --bits 3 --p 2.5 --levels 5 --response gamma --gamma 3",
        "-n 2 --bits 3 --settings 0.01,0.02,0.04",
        "-n 2 --bits 2 --certificate",
        "--bits 3 --tolerance 5 --levels 8",
    ),
    "evaluate": ("--ratios 1,2 --bits 3", "--ratios 1,2 --bits 3 --noise 0.1 --sensitivity"),
    "table show": ("-n 2", "-n 1 --sensitivity --range low"),
    "table build": ("--bits 3 -n 1 --ranges low --responses linear --workers 1 --force",),
    "tradeoff solver": (
        "-n 2 --bits 4 --range low --responses linear --methods camctl --seeds 1 --evaluations 50 "
        "--limit 0.1 --workers 1",
    ),
    "tradeoff simulation": ("--scenes uniform --size 16x12 --tolerances 0 --frames 1 --workers 1",),
    "tradeoff capture": (
        "--scene uniform --size 16x12 --sensor ideal-6 -n 1 --methods doubling --repeats 1 "
        "--workers 1",
    ),
    "figures": ("--only 11 --dpi 30 --force",),
    "calibrate exposure": (
        "--scene uniform -O size=16x12 --sensor ideal-6 --repeats 2 --longest 0.01",
    ),
    "calibrate noise": ("--sensor phone --scene tile-floor -O size=64x48",),
    "calibrate response": ("--scene tile-floor -O size=160x120 -n 6",),
    "help": ("",),
    "doctor": ("",),
    "schema": ("",),
}
"""Command lines that work, and are quick, by command; each option is added to each.  There is no
figure 11: drawing one takes half a minute."""


def commands(group: click.Group, path: str = "") -> Iterator[tuple[str, click.Command]]:
    """Yield each command that does something, with its full name."""
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        assert found is not None
        if isinstance(found, click.Group):
            yield from commands(found, f"{path}{name} ")
        else:
            yield path + name, found


COMMANDS = dict(commands(cli))


def write_photographs(folder: Path) -> None:
    """Write the photographs of `BASES`: three exposures of one ramp."""
    import cv2
    import numpy as np

    light = np.geomspace(0.01, 1, 32 * 24).reshape(24, 32)
    for k in range(3):
        brightness = np.minimum((light * 4.0 ** (k - 1)) ** 0.45 * 255, 255)
        assert cv2.imwrite(str(folder / f"p{k}.png"), brightness.astype(np.uint8))


ENDLESS = {"alpaca --address", "live --count", "studio --address"}
"""Options with which a command runs on for as long as it is asked to: they are only parsed."""
