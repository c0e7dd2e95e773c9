"""Coverage-guided fuzzing of everything that reads what files, cameras and networks send.

    python tests/bench/bench_fuzz.py [--seconds 600] [--inputs 1000000] [--only TEXT]

Each reader of `tests/fuzz` and each wire (PTP over USB, PTP/IP, the packets of the Sierra protocol
and of the CFA635) gets an equal share of the seconds, in a process of its own, under
atheris (libFuzzer; `pip install atheris`), and begins with valid samples.  An input must be read
or refused with an error of camctl, within 500 MB beyond the libraries and 10 s.  Prints the inputs,
the edges of camctl's own bytecode that were reached, and what failed; the input that did is kept.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

HELPERS = Path(__file__).parents[1] / "helpers"
sys.path.insert(0, str(HELPERS))

#: What one process may hold, MB: libraries and the instrumented modules take about 250.
_MOST_MB = 750
_SLOWEST_S = 10


Read: TypeAlias = Callable[[bytes, Path], object]


class _Bytes:
    """What a device sends: the bytes of one input, in pieces of any size."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def read(self, size: int, *_limits: object) -> bytes:
        part, self._data = self._data[:size], self._data[size:]
        return part

    def receive(self, size: int, _timeout_s: float) -> bytes:
        return self.read(size)


def wires() -> dict[str, tuple[list[bytes], Read]]:
    """Return samples of each wire, and what reads an input of it to its end."""
    from array import array

    from camctl.drivers.coolpix.sierra import packets
    from camctl.drivers.ptp import network_link, usb_transport
    from camctl.interface.clock import VirtualClock
    from camctl.menu.panels import cfa635_packets

    def sierra(data: bytes, _folder: Path) -> None:
        line: Any = _Bytes(data)
        while packets.receive(line, 1.0) is not None:
            pass

    def ptp_ip(data: bytes, _folder: Path) -> None:
        link: Any = _Bytes(data)
        reader = network_link.PacketLink(link, "camera", VirtualClock())
        while True:
            reader.receive(1.0, data_bytes=1 << 16)

    def ptp_usb(data: bytes, _folder: Path) -> None:
        pipe = _Bytes(data)
        transport = object.__new__(usb_transport.UsbTransport)
        read = lambda size, _ms: array("B", pipe.read(size))  # noqa: E731
        values = {"_name": "camera", "_left_over": b"", "silence_s": 1.0}
        values["_in"] = SimpleNamespace(wMaxPacketSize=64, read=read)
        vars(transport).update(values)
        for number in range(8):
            transport.receive(number, limit=1 << 16)

    def panel(data: bytes, _folder: Path) -> None:
        reader = cfa635_packets.PacketReader()
        for byte in data:
            list(reader.feed(bytes((byte,))))

    packet = packets.command_packet(b"\x01\x02")
    header = network_link.HEADER.pack(14, network_link.Packet.RESPONSE) + b"\x01\x20\0\0\0\0"
    container = usb_transport.HEADER.pack(12, 3, 0x2001, 0)
    return {
        "wire Sierra": ([packet, b"\x02\x00\x01\x00A\x41\x00\x06"], sierra),
        "wire PTP/IP": ([header, header * 2], ptp_ip),
        "wire PTP over USB": ([container, container * 2], ptp_usb),
        "wire CFA635": ([cfa635_packets.Packet(0x80, b"\x01").encoded()], panel),
    }


def readers() -> dict[str, tuple[Callable[[], list[bytes]], Read]]:
    """Return samples and function of each reader by name."""
    from capture_readers import CAPTURES
    from device_readers import DEVICES
    from input_readers import FILES

    found: dict[str, Any] = {
        name: (reader.samples, reader.read)
        for name, reader in {**FILES, **CAPTURES, **DEVICES}.items()
    }
    for name, (samples, read) in wires().items():
        found[name] = (lambda samples=samples: samples, read)
    return found


def fuzz(samples: list[bytes], read: Read, folder: Path, options: list[str]) -> None:
    """Fuzz one reader in this process, which ends with it."""
    from camctl.errors import CamctlError

    atheris: Any = import_module("atheris")  # has no types

    corpus = folder / "corpus"
    corpus.mkdir()
    for number, sample in enumerate(samples):
        (corpus / str(number)).write_bytes(sample)

    def one_input(data: bytes) -> None:
        with suppress(CamctlError):
            read(data, folder)

    atheris.Setup([sys.argv[0], str(corpus), *options], one_input)
    atheris.Fuzz()


def run(
    name: str, samples: list[bytes], read: Read, seconds: int, inputs: int
) -> tuple[int, int, str]:
    """Fuzz one reader in a child; return the inputs, the edges reached, and what failed."""
    with tempfile.TemporaryDirectory(prefix="camctl-fuzz-") as scratch:
        folder = Path(scratch)
        kept = Path(tempfile.gettempdir()) / f"camctl-fuzz-{re.sub('[^a-z0-9]+', '-', name)}-"
        options = [
            *(f"-max_total_time={seconds}", f"-runs={inputs}", "-max_len=8192"),
            *(f"-rss_limit_mb={_MOST_MB}", f"-timeout={_SLOWEST_S}", "-print_final_stats=1"),
            f"-artifact_prefix={kept}",
        ]
        child = os.fork()
        if child == 0:
            log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT)
            for descriptor in (1, 2):
                os.dup2(log, descriptor)
            try:
                fuzz(samples, read, folder, options)
            finally:
                os._exit(99)
        _, status = os.waitpid(child, 0)
        text = (folder / "log").read_text(errors="replace")
    count = re.findall(r"number_of_executed_units: (\d+)|^#(\d+)", text, re.MULTILINE)
    edges = re.findall(r"cov: (\d+)", text)
    failed = ""
    if status:
        lines = [line for line in text.splitlines() if re.search(r"Error|ERROR|SUMMARY", line)]
        failed = f"status {status}: {' | '.join(lines[:3])[:300]}"
    executed = max((int(a or b) for a, b in count), default=0)
    return executed, int(edges[-1]) if edges else 0, failed


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    atheris: Any = import_module("atheris")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["CAMCTL_CACHE"] = tempfile.mkdtemp(prefix="camctl-fuzz-cache-")
    with atheris.instrument_imports(include=["camctl"]):
        chosen = {name: each for name, each in readers().items() if given.only in name}
        samples = {name: make() for name, (make, _) in chosen.items()}
        with tempfile.TemporaryDirectory() as scratch:
            for name, (_, read) in chosen.items():  # so that what is imported late is there
                for sample in samples[name]:
                    with suppress(Exception):  # the wires end with an error
                        read(sample, Path(scratch))
    began, total = time.monotonic(), 0
    for place, (name, (_, read)) in enumerate(chosen.items()):
        left_s = given.seconds - (time.monotonic() - began)
        share_s = max(2, round(left_s / (len(chosen) - place)))
        inputs, edges, failed = run(name, samples[name], read, share_s, given.inputs)
        total += inputs
        print(f"{name}: {inputs} inputs, {edges} edges {failed}".rstrip(), flush=True)
    print(f"{total} inputs in {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
