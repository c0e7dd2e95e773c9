"""Figures of the package emva1288 for given frames; run by a Python that has the package.

    PYTHON tests/bench/emva1288_reference.py images.json

`bench_noise_calibration.py` makes a virtual environment with the package and calls this.  The file
names the frames (.npy) as the package's own parser would: {"temporal": {time: {photons: [two
files]}}, "spatial": {time: {photons: [files]}}}, with photons 0 for frames without light.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import numpy as np
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.results import Results1288


def main() -> None:
    """Print the figures as JSON."""
    logging.disable(logging.CRITICAL)
    named = json.loads(Path(sys.argv[1]).read_text())
    images = {
        kind: {
            float(time): {float(photons): files for photons, files in by_photons.items()}
            for time, by_photons in by_time.items()
        }
        for kind, by_time in named.items()
    }
    loaded = LoadImageData(images, fload=lambda name: np.load(name).astype(np.int64))
    results = Results1288(Data1288(loaded.data).data)
    figures = {
        "conversion_e_per_dn": 1 / results.K,
        "read_noise_e": results.sigma_d,
        "prnu": results.PRNU1288 / 100,
        "dsnu_e": results.DSNU1288,
    }
    print(json.dumps({name: float(value) for name, value in figures.items()}))


if __name__ == "__main__":
    main()
