"""Aravis's own programs as foreign clients of the virtual GigE Vision camera."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest
from gige_bench import virtual_camera

TOOL, CAMERA_TEST = "arv-tool-0.8", "arv-camera-test-0.8"

pytestmark = pytest.mark.skipif(
    not (shutil.which(TOOL) and shutil.which(CAMERA_TEST)),
    reason="needs arv-tool-0.8: apt-get install aravis-tools aravis-tools-cli",
)


def run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert not done.stderr
    return done.stdout


def test_features_are_listed_and_set() -> None:
    with virtual_camera() as device:
        features = run(TOOL, "-a", device.config.ip, "features")
        for each in ("ExposureTime", "SequencerSetSave", "ChunkTimestamp", "TriggerSoftware"):
            assert f"'{each}'" in features
        settings = ("ExposureAuto=Off", "ExposureTime=4321", "GainAuto=Off", "Gain=6")
        shown = run(TOOL, "-a", device.config.ip, "control", *settings, "ExposureTime", "Gain")
        assert "ExposureTime = 4321 us min:10 max:1e+07" in shown
        assert device.state()["time_s"] == 0.004321
        assert device.state()["gain"] == pytest.approx(10 ** (6 / 20))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "rate"),
    [(["-f", "20", "-e", "4000"], 20), (["-o", "10", "-e", "3000"], 10), (["-w", "64"], 50)],
    ids=["free-run", "software-trigger", "plain"],
)
def test_frames_arrive_complete(options: list[str], rate: int) -> None:
    """Without packets of the interface's own, for which a loop-back address has none."""
    with virtual_camera(automatic=False) as device:
        shown = run(
            *(CAMERA_TEST, "-n", device.config.ip, "--duration", "3", "--no-packet-socket"),
            *("-u", "ExposureTime", *options),
        )
        counts = dict(re.findall(r"(n_\w+) *= (\d+)", shown))
        assert int(counts["n_completed_buffers"]) > 0.5 * 3 * rate
        assert {counts[each] for each in ("n_failures", "n_missing_packets")} == {"0"}
        frames = device.do("log")["frames"]
        stated = [float(each) for each in re.findall(r"ChunkExposureTime = (\d+)", shown)]
        assert set(stated) == {round(each["time_s"] * 1e6) for each in frames[1:-1]}
