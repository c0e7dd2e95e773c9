"""What the tests of the CoolPix driver share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from coolpix_bench import virtual_coolpix

from camctl.sim.devices.sierra.device import SierraDevice


@pytest.fixture
def device() -> Iterator[SierraDevice]:
    """A virtual CoolPix in virtual time."""
    with virtual_coolpix() as device:
        yield device
