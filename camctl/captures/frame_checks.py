"""The exposures of a capture's frames: checked as they arrive, judged and corrected at the end."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.captures.true_exposures import choose_exposures, estimate_exposures
from camctl.captures.verdict import judge, suspected, suspects
from camctl.evidence.chroma import states_few_chroma_samples
from camctl.evidence.damage import Repeat, damaged_share, repeated_lines
from camctl.evidence.delay import ShotLog
from camctl.evidence.light_ratio import MOST_CHANGE, FrameSample, NeighbourCheck
from camctl.evidence.patches import Patches, patch_places
from camctl.evidence.raster_damage import (
    LightLimits,
    damaged_lines,
    is_wrong_alone,
    light_limits,
    wrong_lines,
)
from camctl.evidence.ratio_check import RatioCheck
from camctl.evidence.residual import Pair, Side
from camctl.evidence.shown_levels import other_levels
from camctl.findings import Finding, Place
from camctl.interface.camera import Camera, Pixels
from camctl.interface.controls import ExposureControls, Layout, ResponseOrigin
from camctl.model.noise import FrameNoise
from camctl.model.sensor import ESTIMATED_RESPONSE_ERROR, FILE_OFFSET, RESPONSE_ERROR
from camctl.pictures.details import thumbnail
from camctl.records.frame import ExposureRatio, StoredFrame
from camctl.records.report import UnfinishedCapture


class FrameChecks:
    """The checks of one capture; results are written into its report.

    Attributes:
        thumbnails: small pictures of the frames that have arrived, by position

    Args:
        camera: that shoots it
        capture: its report
    """

    def __init__(self, camera: Camera, capture: UnfinishedCapture) -> None:
        self._controls, self._capture = camera.controls, capture
        self._check = NeighbourCheck(
            self._controls.levels,
            self._controls.black,
            self._controls.layout,
            pairs=len(capture.plan.settings) - 1,
            response_error=_response_error(self._controls),
            offset=_offset(self._controls),
        )
        self._shots: list[FrameSample] = []  # of all sequences, in their order
        self._awaited: set[int] = set()
        self._log = ShotLog(
            capture.plan.settings,
            self._controls,
            lambda one, other, expected: self._check.compare(
                self._shots[one], self._shots[other], expected
            ),
            lambda shot: float(self._shots[shot].patches.mean()),
            capture.request.mains_hz,
        )
        self._delay_of = camera.info.id if self._log.has_delay else None
        self.thumbnails: dict[int, NDArray[np.uint8]] = {}
        self._light: dict[int, LightLimits] = {}
        self._repeats: dict[int, frozenset[Repeat]] = {}
        self._damage: dict[int, float] = {}  # share that shows no scene, of frames judged so far

    def begin(self, positions: Sequence[int]) -> None:
        """Record that the frames at `positions` are shot now, in one sequence."""
        self._log.begin(positions)
        self._awaited = set(positions)

    def add(self, position: int, pixels: Pixels) -> None:
        """Compare the frame at `position` with its neighbours that have arrived."""
        applied, controls = self._frame(position).applied, self._controls
        noise = controls.frame_noise([applied])[0] if controls.noise else None
        sample = self._check.add(position, pixels, noise)
        if position in self._awaited:
            self._shots.append(sample)
        self._forget_damage(position)
        if noise is not None:
            self._repeats[position] = repeated_lines(pixels, self._check.scale, noise)
        self.thumbnails[position] = thumbnail(pixels, self._controls)
        for later in (position, position + 1):
            if self._check.has(later):
                before, after = (
                    self._controls.exposure(self._frame(k).applied) for k in (later - 1, later)
                )
                self._frame(later).ratio = self._compare(later, after / before)

    def remove(self, position: int) -> None:
        """Forget the frame at `position`: it will be shot again."""
        self._check.remove(position)
        self._forget_damage(position)

    def end(self) -> None:
        """Free the patches of the frames, 0.6 MB of each, once all that they show is known."""
        self._check.clear()
        self._light.clear()
        self._shots.clear()

    def suspects(self) -> list[int]:
        """Return the positions of the frames that are probably wrong and were shot once.

        None where frames cannot be shot again.
        """
        if not self._controls.repeatable:
            return []
        if self._may_settle and (error := self._log.find()) is not None and error.is_certain:
            return []  # all of them are
        checks = [frame.ratio for frame in self._frames]
        # What is wrong with the exposure of a damaged frame, and of those beside it, is not known;
        # of a wrong exposure only the brighter lines may contradict the other frames.
        wrong = sorted({*self._damaged(), *self._repeated_lines(), *self._damaged_lines()})
        if wrong:  # those beside them may be damaged, too
            while alone := self._alone(wrong):
                wrong = sorted({*wrong, *alone})
        else:
            wrong = suspects(checks) or self._alone() or self._with_wrong_lines()
        return [k for k in wrong if self._frame(k).attempts == 1]

    @property
    def are_to_settle(self) -> bool:
        """Whether the control delay may be wrong: where the camera settles, its frames tell."""
        return self._may_settle and self._log.find() is not None

    @property
    def _may_settle(self) -> bool:
        """Whether frames can be shot again, and the camera does not settle at each exposure yet."""
        controls = self._controls
        is_unknown = "delay_unknown" in (finding.code for finding in controls.findings)
        is_stream = controls.repeatable and self._log.has_delay
        return is_stream and not is_unknown and not self._log.has_settled

    def settle(self) -> None:
        """Record that the camera settles at each exposure from now on."""
        self._log.settle()

    def judge(self) -> list[ExposureRatio]:
        """Write into the report what the frames say of their exposures; return those to use."""
        frames = self._frames
        checks = [frame.ratio for frame in frames]
        error = self._log.find_old() if self._log.has_settled else self._log.find()
        if error is not None and not error.is_probable:
            error = None
        estimates = None
        if self._capture.request.estimate_ratios and len(frames) > 1:
            estimates, findings = estimate_exposures(
                frames, self.samples, self._check.scale, self._controls
            )
            self._capture.findings += findings
        chosen = choose_exposures(frames, self._controls, estimates)
        if estimates is not None:
            checks[1:] = [
                self._compare(k, chosen[k].exposure / chosen[k - 1].exposure)
                for k in range(1, len(frames))
            ]
        reasons, others = judge(
            self._capture,
            checks,
            error,
            self._delay_of,
            exposures_exact=self._controls.exposures_exact,
        )
        relative = [each.exposure for each in chosen]
        if any(check and check.contradicting for check in checks) and (
            found := other_levels(self.samples, relative, self._controls)
        ):
            reasons, others = found, []  # with a wrong level, exposures seem to be wrong
        self._capture.distrust([*reasons, *self._damage_findings()])
        self._capture.findings += [*others, *self._delay_settled()]
        return chosen

    def _damage_findings(self) -> list[Finding]:
        """Return which frames are damaged, each once."""
        found = {
            position: Finding(code="frame_damaged", frames=(position,), value=share)
            for position, share in self._damaged().items()
        }
        places = {
            "lines_repeated": self._repeated_lines(),
            "lines_damaged": self._damaged_lines(),
        }
        for code, frames in places.items():
            for position, place in frames.items():
                share = (place.bottom - place.top) / self._controls.shape[0]
                finding = Finding(code=code, frames=(position,), value=share, place=place)
                found.setdefault(position, finding)
        return list(found.values())

    def _delay_settled(self) -> list[Finding]:
        """Return that the control delay was wrong, where the camera has settled since."""
        error = self._log.find() if self._log.has_settled else None
        if error is None or not error.is_probable:
            return []
        remedies = {"calibrate_delay": self._delay_of}
        return [Finding(code="delay_settled", value=error.shift, remedies=remedies)]

    @property
    def samples(self) -> list[Patches]:
        """Patches of each frame."""
        return [each.patches for each in self._check.samples(len(self._capture.frames))]

    def samples_outside(self, cells: NDArray[np.bool_], cell: int) -> list[Patches]:
        """Return the patches of each frame that lie outside of these cells of so many pixels."""
        rows, columns, side, step = self._places()
        inside = np.pad(cells.astype(np.intp), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
        (top, bottom), (left, right) = (
            (at * step // cell, ((at + side) * step - 1) // cell + 1) for at in (rows, columns)
        )
        below, above = (inside[at][:, right] - inside[at][:, left] for at in (bottom, top))
        kept = (below == above).ravel()
        return [each[np.tile(kept, len(each) // kept.size)] for each in self.samples]

    def pairs(self, exposures: Sequence[float], noise: Sequence[FrameNoise] | None) -> list[Pair]:
        """Return the frames neighbouring in exposure, from the shortest on, to find movement.

        Where the whole of a frame does not fit its exposure, as under lamps that flicker, the pair
        has the ratio of light that most patches show; not where things that moved are all that can
        be compared, unless it explains far more of the samples.

        Args:
            exposures: relative exposures of the frames
            noise: noise of each frame; None where it is unknown
        """
        sides = [
            Side(place, exposure, None if noise is None else noise[place])
            for place, exposure in enumerate(exposures)
        ]
        sides.sort(key=lambda side: side.exposure)
        samples, found = self._check.samples(len(sides)), []
        few = states_few_chroma_samples(each.details for each in self._capture.frames if each)
        # Colours whose responses are not quite alike are distinguished where that is measured.
        colours = 3 if noise is None and self._controls.layout is Layout.RGB else 1
        for short, long in pairwise(sides):
            ratio = long.exposure / short.exposure
            both = samples[short.position], samples[long.position]
            check = self._check.compare(*both, ratio)
            patches = both[0].patches, both[1].patches
            pair = Pair(self._check.scale, short, long, ratio, patches, colours, few)
            if not check.agrees and check.measured is not None:
                shown = replace(pair, ratio=check.measured)
                if check.is_one_ratio or shown.contradicting < pair.contradicting / 2:
                    pair = shown
            found.append(pair)
        return found

    def _damaged(self) -> dict[int, float]:
        """Return the share of each damaged frame that shows no scene, by position.

        Where noise may be as wide as the range of the codes it is not known.
        """
        if self._check.scale.is_coarse:
            return {}
        samples = self.samples
        codes = self._controls.white - self._controls.black + 1
        for position, each in enumerate(samples):
            if position not in self._damage:
                beside = [*samples[max(position - 1, 0) : position], *samples[position + 1 :][:1]]
                self._damage[position] = damaged_share(each, beside, codes)
        return {place: share for place, share in sorted(self._damage.items()) if share}

    def _damaged_lines(self) -> dict[int, Place]:
        """Return where lines of frames contradict most other frames, by position.

        Frames that cannot be shot again were compared before.
        """
        if not (self._shows_lines and self._controls.repeatable):
            return {}
        rows, columns, side, step = self._places()
        found = damaged_lines(self._limits(), self._exposures, (rows.size, columns.size))
        height, width = self._controls.shape
        return {
            position: Place(
                top=int(rows[first]) * step,
                left=0,
                bottom=min((int(rows[stop - 1]) + side) * step, height),
                right=width,
            )
            for position, (first, stop) in found.items()
        }

    def _repeated_lines(self) -> dict[int, Place]:
        """Return where lines of frames are earlier ones once more, by position.

        What a camera repeats in other frames, too, is how it makes them.
        """
        found = {}
        for position, repeats in sorted(self._repeats.items()):
            others = (each for place, each in self._repeats.items() if place != position)
            if lines := [repeat.line for repeat in repeats.difference(*others)]:
                height, width = self._controls.shape
                found[position] = Place(top=min(lines), left=0, bottom=height, right=width)
        return found

    def _alone(self, damaged: Collection[int] = ()) -> list[int]:
        """Return the frames that contradict those beside them where these agree with each other.

        Whatever was in such a frame alone, another frame is better.

        Args:
            damaged: frames that are damaged, and that others are not compared with
        """
        kept = [k for k in range(len(self._capture.frames)) if k not in damaged]
        if len(kept) < 3 or not self._shows_lines:
            return []
        limits, exposures, found = self._limits(), self._exposures, []
        last = len(kept) - 3  # where three frames begin
        for number, place in enumerate(kept):
            # One beside a damaged frame may be damaged, too, and hide this one: any three tell.
            firsts = range(max(number - 2, 0), min(number, last) + 1)
            for first in firsts if damaged else [min(max(number - 1, 0), last)]:
                one, other = (k for k in kept[first : first + 3] if k != place)
                some = (limits[one], limits[place], limits[other])
                if is_wrong_alone(some, (exposures[one], exposures[place], exposures[other])):
                    found.append(place)
                    break
        return found

    def _with_wrong_lines(self) -> list[int]:
        """Return the positions of frames some lines of which were probably lost or shifted."""
        if not self._shows_lines:
            return []
        limits, exposures = self._limits(), self._exposures
        rows, columns, *_ = self._places()

        def differ(one: int, other: int) -> bool:
            ratio = exposures[other] / exposures[one]
            return wrong_lines((limits[one], limits[other]), ratio, (rows.size, columns.size))

        wrong = [later for later in range(1, len(limits)) if differ(later - 1, later)]
        # Where the frames on both sides differ, too, something as wide as the picture moved.
        moved = {later for later in wrong if later + 1 in wrong and differ(later - 1, later + 1)}
        return suspected(k for k in wrong if not {k, k - 1} & moved)

    @property
    def _shows_lines(self) -> bool:
        """Whether light is known: of an assumed response lines may differ by their brightness."""
        is_assumed = self._controls.response_origin is ResponseOrigin.ASSUMED
        return not (self._check.scale.is_coarse or is_assumed)

    def _limits(self) -> list[LightLimits]:
        """Return between which limits the light of each frame is."""
        samples = self._check.samples(len(self._capture.frames))
        for position, each in enumerate(samples):
            if position not in self._light:
                self._light[position] = light_limits(each, self._check.scale)
        return [self._light[position] for position in range(len(samples))]

    def _places(self) -> tuple[NDArray[np.intp], NDArray[np.intp], int, int]:
        """Return rows, columns and side of the patches of a colour, and its lines' distance."""
        controls = self._controls
        colours = (3,) if controls.layout is Layout.RGB else ()
        planes = controls.layout.planes(np.empty((*controls.shape, *colours), np.uint8))
        step = round(controls.shape[0] / planes[0].shape[0])  # 2 in a mosaic
        return *patch_places([each.shape for each in planes]), step

    @property
    def _exposures(self) -> list[float]:
        return [self._controls.exposure(frame.applied) for frame in self._frames]

    def _forget_damage(self, position: int) -> None:
        """Forget what is known of a frame that changed, and of those judged beside it."""
        self._light.pop(position, None)
        self._repeats.pop(position, None)
        for place in (position - 1, position, position + 1):
            self._damage.pop(place, None)

    @property
    def _frames(self) -> list[StoredFrame]:
        return [self._frame(position) for position in range(len(self._capture.frames))]

    def _frame(self, position: int) -> StoredFrame:
        frame = self._capture.frames[position]
        assert frame is not None  # it was added
        return frame

    def _compare(self, later: int, expected: float) -> RatioCheck:
        times_s = (self._frame(later - 1).applied_s, self._frame(later).applied_s)
        most = MOST_CHANGE if self._controls.exposures_exact else math.inf
        return self._check.check(later, expected, times_s, self._capture.request.mains_hz, most)


def _response_error(controls: ExposureControls) -> float:
    """Return the relative error of a response: of most photographs it is estimated from them."""
    is_estimated = controls.response_origin is not ResponseOrigin.STATED
    is_of_photographs = is_estimated and not controls.exposures_exact
    return ESTIMATED_RESPONSE_ERROR if is_of_photographs else RESPONSE_ERROR


def _offset(controls: ExposureControls) -> float:
    """Return the standard deviation of the offset of frames, which photographs of 8 bits have."""
    is_of_photographs = not controls.exposures_exact and controls.noise is None
    return FILE_OFFSET if is_of_photographs and controls.bits == 8 else 0.0
