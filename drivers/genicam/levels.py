"""What the samples of a GenICam camera stand for: their bits, black and white, and their gamma."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from camctl.drivers.common.packed_samples import used_bits
from camctl.drivers.genicam.formats import PixelFormat
from camctl.drivers.genicam.port import FeatureError, Kind, OpenDevice, Received
from camctl.drivers.genicam.preparation import GenicamOptions
from camctl.errors import UsageError
from camctl.findings import Finding, note


@dataclass(frozen=True)
class SampleLevels:
    """The samples of a camera.

    Attributes:
        bits: that are used
        shift: bits below the used ones
        black, white: levels, DN
        findings: what was assumed of them
    """

    bits: int
    shift: int
    black: int
    white: int
    findings: tuple[Finding, ...]


def sample_levels(
    options: GenicamOptions, pixel_format: PixelFormat, first: Received
) -> SampleLevels:
    """Return what the samples stand for, by the options and the first frame.

    Raises:
        UsageError: the options do not suit the format
    """
    bits, shift, findings = pixel_format.bits, 0, []
    if options.bits is not None and bits != 16:
        raise UsageError(
            f"the option bits={options.bits} does not apply to {pixel_format.name}",
            hint="it states how many bits of a 16-bit format are used",
        )
    if bits == 16:
        pixels = pixel_format.samples(first)
        bits = options.bits or (16 if pixels is None else used_bits(pixels))
        shift = 16 - bits
        if shift and options.bits is None:
            findings.append(
                note(
                    f"the upper {bits} bits of 16 are used, by the first frame",
                    {"option:bits": str(bits)},
                )
            )
    most, black = 2**bits - 1, options.black or 0
    white = most if options.white is None else options.white
    if not black < white <= most:
        raise UsageError(
            f"invalid black level {black} and white level {white}",
            hint=f"give 0 <= black < white <= {most} DN",
        )
    if options.black is None:
        findings.append(
            note(
                "black is assumed to be 0: cover the lens, measure the mean brightness, and "
                "give it",
                {"option:black": None},
            )
        )
    return SampleLevels(bits, shift, black, white, tuple(findings))


def has_no_gamma(device: OpenDevice) -> bool:
    """Return whether the camera's samples are linear: its gamma is off, or it has none."""
    with suppress(FeatureError):
        if device.kind("GammaEnable") is Kind.BOOLEAN:
            return device.read("GammaEnable") is False
        if device.kind("Gamma") is Kind.FLOAT:
            return device.read("Gamma") == 1.0
    return True
