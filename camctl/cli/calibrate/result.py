"""How calibrations print their result: of which camera, in which mode, and where it is kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.cli import output

if TYPE_CHECKING:
    from camctl.findings import Finding
    from camctl.interface.camera import CameraInfo

Rows = Iterable[tuple[str, str]]


def camera_row(info: CameraInfo) -> tuple[str, str]:
    """Return what a camera is called."""
    return "camera", f"{info.make} {info.model} ({info.id})"


@dataclasses.dataclass(frozen=True)
class Result:
    """What was measured; camera and file are None where photographs name no camera."""

    info: CameraInfo | None
    mode: str
    file: Path | None

    def print_json(self, content: Mapping[str, Any]) -> None:
        """Print the content with the camera, its mode and the file."""
        camera = None if self.info is None else dataclasses.asdict(self.info)
        output.print_json({**content, "camera": camera, "mode": self.mode, "file": self.file})

    def print_text(self, table: str, rows: Rows, more: Rows = ()) -> None:
        """Print a table and rows, with the camera, its mode and the file between both rows."""
        own = [] if self.info is None else [camera_row(self.info), ("mode", self.mode)]
        kept = [] if self.file is None else [("profile", str(self.file))]
        fields = output.format_fields([*rows, *own, *kept, *more])
        output.print_text(f"{table}\n\n{fields}" if table else fields)


class Findings:
    """Prints findings when they are made, and keeps them for the JSON output."""

    def __init__(self) -> None:
        self._kept: list[Finding] = []

    def add(self, finding: Finding) -> None:
        """Print a finding as a warning, and keep it."""
        output.print_finding(finding)
        self._kept.append(finding)

    def to_json(self) -> list[dict[str, Any]]:
        """Return the findings for the JSON output."""
        return [each.model_dump() for each in self._kept]
