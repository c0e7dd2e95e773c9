"""How often the true irradiance lies within the 68 % and 95 % intervals of a radiance map.

The intervals are radiance -+ 0.994 and 1.960 of `sd.*`.  Each scene is shot with the standard
sensor, constant contrast, 1:1,000, 3 exposures: as metered, and 0.5 to 1.4 stops longer, so that
there is light within 3 % of saturation.  The street has lamps on 50 Hz mains: its exposures are
whole periods of their flicker, which noise does not predict.
Run by hand: ``python tests/bench/bench_coverage.py [MEMORIAL.hdr]``; about half a minute.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from accuracy import NEAR_SATURATION, NOMINAL, radiance_errors

from camctl.exposure.goal import CaptureRequest
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

#: Largest difference from the nominal share, and the fewest samples that show it to 1 point.
LIMIT, LEAST_SAMPLES = 0.015, 4000
#: The captures in which light near saturation is looked for are longer by these stops.
LONGER_STOPS = [0.5 + step / 16 for step in range(16)]


def main() -> int:
    """Print the table; return 1 unless every part with enough samples is within the limit."""
    sensor, failures = load_sensor("standard"), 0
    print(f"{'scene':14} {'part':16} {'68 %':>7} {'95 %':>7} {'samples':>9}", flush=True)
    for name in ("tile-floor", "ramp", "room", "night-street", *sys.argv[1:]):
        request = CaptureRequest("log", 1000.0, 3)
        if name == "night-street":
            request = replace(request, base_s=0.01, mains_hz=50.0)
        scene = load_scene(name)
        metered = radiance_errors(scene, sensor, request)
        longer = radiance_errors(scene, sensor, request, LONGER_STOPS)
        rows = [(part, metered, where) for part, where in metered.parts().items()]
        rows.append(("near saturation", longer, longer.E >= NEAR_SATURATION))
        for part, errors, where in rows:
            samples, shares = int(where.sum()), errors.shares(where)
            wrong = max(abs(share - n) for share, n in zip(shares, NOMINAL, strict=True)) > LIMIT
            failures += wrong and samples >= LEAST_SAMPLES
            remark = "  beyond 1.5 points" if wrong else ""
            if samples < LEAST_SAMPLES:
                remark = "  too few to judge"
            print(
                f"{Path(name).stem:14} {part:16} {shares[0]:7.1%} {shares[1]:7.1%} {samples:9}"
                f"{remark}",
                flush=True,
            )
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
