"""The picture of an effective camera from photographs already taken."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from camctl.captures.sequencer import capture
from camctl.exposure.goal import AUTO, RANGE_WITHOUT_LIGHT, CaptureRequest
from camctl.findings import Finding
from camctl.messages.plain import sentence
from camctl.photographs.camera import detailed
from camctl.photographs.choice import (
    darkest_light,
    plan_photographs,
    why_unused,
    with_dark_share,
)
from camctl.photographs.photograph_set import (
    OpenedPhotographs,
    PhotographOptions,
    open_photographs,
)
from camctl.records.capture_plan import CapturePlan
from camctl.records.folder_store import FolderStore
from camctl.records.report import CaptureReport


@dataclass(frozen=True, eq=False)
class MergePlan:
    """Which of the photographs are used, and why not the others.

    Attributes:
        opened: the photographs
        request: with the range and the exposures that were chosen
        plan: of the picture
    """

    opened: OpenedPhotographs
    request: CaptureRequest
    plan: CapturePlan

    @property
    def photographs(self) -> list[dict[str, Any]]:
        """Exposure of each photograph, whether it is used, and why not."""
        camera, used = self.opened.camera, self._used
        reasons = why_unused(camera, self.plan)
        return [
            {
                "file": each.name,
                "time_s": each.time_s,
                "gain": each.gain,
                "f_number": each.f_number,
                "used": k in used,
                "why_not": reasons.get(k),
            }
            for k, each in enumerate(camera.photographs)
        ]

    @property
    def notes(self) -> list[Finding]:
        """Findings that are warnings."""
        used = self._used
        displaced = (
            detailed(each, summed=k in used and len(used) > 1, used=k in used)
            for k, each in self.opened.displaced.items()
        )
        return [self._of_frames(each) for each in (*self.opened.notes, *displaced)]

    @property
    def facts(self) -> tuple[Finding, ...]:
        """Findings that are no warnings."""
        return tuple(map(self._of_frames, self.opened.facts))

    @property
    def _used(self) -> list[int]:
        """Positions of the photographs that are used, frame by frame."""
        return self.opened.camera.chosen(self.plan.settings)

    def _of_frames(self, finding: Finding) -> Finding:
        """Return a finding about files, given by their positions, as one about frames.

        A file that is no frame of the picture is named in its details alone.
        """
        files = [self.opened.positions[k] for k in self._used]
        frames = tuple(files.index(k) for k in finding.frames if k in files)
        return finding.model_copy(update={"frames": frames})

    @property
    def source(self) -> dict[str, Any]:
        """What the report says of the photographs, as `CaptureReport.source`."""
        return {
            "photographs": self.photographs,
            "response_from": self.opened.response,
            "facts": [
                {"text": sentence(each), **each.model_dump(mode="json")} for each in self.facts
            ],
        }

    def capture(self, path: str | os.PathLike[str] | None, *, overwrite: bool) -> CaptureReport:
        """Sum the photographs that are used, and write the pictures; see `merge`."""
        plan = replace(self.plan, findings=(*self.notes, *self.plan.findings))
        camera, source = self.opened.camera, self.source
        return capture(camera, self.request, path, plan=plan, source=source, overwrite=overwrite)


def plan_merge(
    files: Sequence[str | os.PathLike[str]], request: CaptureRequest, options: PhotographOptions
) -> MergePlan:
    """Read photographs, and choose those that serve a picture; arguments as for `merge`."""
    request = replace(request, deghost=request.deghost or options.removes_ghosts)
    is_auto = request.dynamic_range == AUTO
    if is_auto:
        # Until the light of the photographs gives it.
        request = replace(request, dynamic_range=RANGE_WITHOUT_LIGHT)
    opened = open_photographs([Path(each) for each in files], options)
    camera, patches = opened.camera, opened.patches
    darkest = darkest_light(camera, patches) if is_auto else None
    plan, request = plan_photographs(camera, request, darkest)
    return MergePlan(opened, request, with_dark_share(camera, plan, patches))


def merge(
    files: Sequence[str | os.PathLike[str]],
    request: CaptureRequest | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    options: PhotographOptions | None = None,
    overwrite: bool = False,
) -> CaptureReport:
    """Make the picture that `request` asks for from photographs of one scene, as `camctl merge`.

    All are summed, but for those that are proven wrong, or as many as the request says.

    Args:
        files: photographs with different exposures: JPEG, PNG, TIFF, camera raw, linear OpenEXR
        request: the desired picture; None: response "log" over the range of the light in the
            photographs; without `count` and `ratios` all of these are used
        path: folder of the result, which is made; None: all is kept in memory
        options: what is known of the photographs beside their files
        overwrite: replace an earlier result in the folder

    Returns:
        the report; `source["photographs"]` says which photographs are used, and why not the
        others, `findings` what was found wrong with them, and `source["facts"]` what was done

    Raises:
        UsageError: the request or an option cannot be met, or an exposure is missing
        DataError: a file cannot be read, or the photographs do not fit each other or their labels
        CaptureError: no set of the photographs makes the picture
        StorageError: a file cannot be written, or the folder holds another result
    """
    if path is not None:
        FolderStore.check_free(Path(path), overwrite=overwrite)
    asked = request or CaptureRequest()
    found = plan_merge(files, asked, options or PhotographOptions())
    return found.capture(path, overwrite=overwrite)
