"""Renders frames with Pyxel for `bench_sensor.py`; needs an interpreter with pyxel-sim.

Photon noise, full well, read noise and ADC, each by Pyxel's own model, with one draw for photons
and one for reading, as in `sim`.  For each line on standard input one frame is rendered, and the
CPU seconds of all threads are printed.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from pyxel.detectors import CCD, CCDGeometry, Characteristics, Environment
from pyxel.detectors.charge_to_volt_settings import ChargeToVoltSettings, SensitiveChargeToVolt
from pyxel.models.charge_collection import simple_collection, simple_full_well
from pyxel.models.charge_generation import simple_conversion
from pyxel.models.charge_measurement import output_node_noise, simple_measurement
from pyxel.models.photon_collection import shot_noise
from pyxel.models.readout_electronics import simple_adc, simple_amplifier


def main() -> None:
    """Render a frame for each line on standard input and print its seconds."""
    rows, columns = int(sys.argv[1]), int(sys.argv[2])
    photons = np.linspace(0.0, 20_000.0, rows * columns).reshape(rows, columns)
    detector = CCD(
        geometry=CCDGeometry(row=rows, col=columns),
        environment=Environment(temperature=300),
        characteristics=Characteristics(
            quantum_efficiency=0.5,
            charge_to_volt=SensitiveChargeToVolt(ChargeToVoltSettings(value=1e-6)),
            pre_amplification=100,
            full_well_capacity=10_000,
            adc_bit_resolution=8,
            adc_voltage_range=(0.0, 1.0),
        ),
    )
    for _ in sys.stdin:
        detector.empty()
        start = time.process_time()
        detector.photon.array = photons.copy()
        shot_noise(detector)
        # Photons are drawn already: conversion must not draw a second time.
        simple_conversion(detector, binomial_sampling=False)
        simple_collection(detector)
        simple_full_well(detector)
        simple_measurement(detector)
        output_node_noise(detector, std_deviation=3e-6)
        simple_amplifier(detector)
        simple_adc(detector)
        print(time.process_time() - start, flush=True)
    assert 0 < detector.image.array.mean() < 255


if __name__ == "__main__":
    main()
