"""The conformance suite on one camera that stays open: opening each takes long."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import pytest

from camctl.interface.camera import Camera
from camctl.testing.conformance import CameraConformance


class KeptOpenConformance(CameraConformance):
    """The suite on one camera for all of its tests; only one can be open at a time."""

    _kept: ClassVar[Camera | None] = None

    @abstractmethod
    def open_anew(self) -> Camera:
        """Return the camera, opened by the backend that is tested."""

    @pytest.fixture
    def camera(self) -> Camera:
        """The camera that stays open."""
        kind = type(self)
        if kind._kept is None:
            kind._kept = self.open_anew()
        return kind._kept

    def open_camera(self) -> Camera:
        """Return the camera opened anew: the one that stays open is closed before."""
        self._close()
        return self.open_anew()

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _closed_at_the_end(cls) -> Iterator[None]:
        yield
        cls._close()

    @classmethod
    def _close(cls) -> None:
        camera, cls._kept = cls._kept, None
        if camera is not None:
            camera.close()
