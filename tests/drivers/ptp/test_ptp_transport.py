"""Containers cut in every way that USB allows, on endpoints without a device."""

from __future__ import annotations

import errno
import struct
from array import array
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import pairwise

import pytest
import usb.core
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.drivers.ptp.transport import DATA, RESPONSE, IncompleteDataError
from camctl.drivers.ptp.usb_transport import UsbTransport
from camctl.errors import (
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
)
from camctl.interface.clock import VirtualClock

PACKET = 64
OK, BUSY = 0x2001, 0x2019


class Endpoint:
    """Returns the given transfers one by one; an int stands for the error of that number."""

    wMaxPacketSize = PACKET  # noqa: N815 - pyusb's name

    def __init__(self, address: int, attributes: int) -> None:
        self.bEndpointAddress, self.bmAttributes = address, attributes
        self.transfers: list[bytes | int] = []
        self.sent: list[bytes] = []
        self.reads: list[int] = []

    def read(self, size: int, timeout: int) -> array[int]:
        self.reads.append(size)
        if not self.transfers:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        first = self.transfers.pop(0)
        if isinstance(first, int):
            raise usb.core.USBError("x", -1, first)
        if len(first) > size:
            if size % PACKET:
                raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
            self.transfers.insert(0, first[size:])
        return array("B", first[:size])

    def write(self, data: bytes, timeout: int) -> int:
        self.sent.append(bytes(data))
        return len(data)

    def clear_halt(self) -> None:
        pass


class Interface:
    bInterfaceClass, bInterfaceSubClass, bInterfaceProtocol = 6, 1, 1  # noqa: N815 - pyusb's names
    bInterfaceNumber = 0  # noqa: N815

    def __init__(self, endpoints: list[Endpoint]) -> None:
        self.endpoints = endpoints

    def __iter__(self) -> Iterator[Endpoint]:
        return iter(self.endpoints)


class Context:
    """pyusb's book-keeping of claimed interfaces."""

    def managed_claim_interface(self, device: object, number: int) -> None:
        pass

    managed_release_interface = managed_claim_interface

    def dispose(self, device: object) -> None:
        pass


class Device:
    def __init__(self) -> None:
        self.bulk_in, self.bulk_out = Endpoint(0x81, 2), Endpoint(0x02, 2)
        self.events = Endpoint(0x83, 3)
        self._ctx = Context()
        self.interface = Interface([self.bulk_in, self.bulk_out, self.events])
        self.controls: list[tuple[int, int]] = []
        self.status = struct.pack("<HH", 4, OK)
        self.times_configured = 0
        self.is_configured = True

    def get_active_configuration(self) -> list[Interface]:
        if not self.is_configured:
            raise usb.core.USBError("Configuration not set", -5, errno.ENOENT)
        return [self.interface]

    def set_configuration(self) -> None:
        self.times_configured += 1
        self.is_configured = True

    def is_kernel_driver_active(self, number: int) -> bool:
        raise NotImplementedError

    def ctrl_transfer(
        self, kind: int, request: int, value: int, index: int, data: bytes, timeout: int
    ) -> array[int] | int:
        self.controls.append((kind, request))
        return array("B", self.status) if kind & 0x80 else len(data)


def transport(transfers: Sequence[bytes | int] = ()) -> tuple[UsbTransport, Device]:
    device = Device()
    device.bulk_in.transfers = list(transfers)
    return UsbTransport(device, "the camera", VirtualClock()), device


def container(kind: int, code: int, number: int, payload: bytes = b"") -> bytes:
    return struct.pack("<IHHI", 12 + len(payload), kind, code, number) + payload


RESPONSE_3 = container(RESPONSE, OK, 3)


class TestReceiving:
    @given(
        payload=st.binary(max_size=400),
        cuts=st.lists(st.integers(1, 500), max_size=6),
        empty=st.lists(st.booleans(), min_size=8, max_size=8),
        merged=st.booleans(),
    )
    def test_data_is_complete_however_it_is_cut(
        self, payload: bytes, cuts: list[int], empty: list[bool], merged: bool
    ) -> None:
        whole = container(DATA, 0x1009, 3, payload)
        edges = sorted({0, len(whole), *(c for c in cuts if c < len(whole))})
        pieces = [whole[a:b] for a, b in pairwise(edges)]
        if merged:
            pieces[-1] += RESPONSE_3
        else:
            pieces.append(RESPONSE_3)
        transfers: list[bytes | int] = []
        for piece, is_empty in zip(pieces, [*empty, *[False] * 9], strict=False):
            transfers += [b"", piece] if is_empty else [piece]
        pipes, _ = transport(transfers)
        assert pipes.receive(3, limit=1000).payload == payload
        assert pipes.receive(3, limit=0).code == OK

    @given(transfers=st.lists(st.binary(max_size=100) | st.just(b""), max_size=20))
    def test_arbitrary_bytes_end_in_a_typed_error(self, transfers: list[bytes | int]) -> None:
        pipes, _ = transport(transfers)
        with suppress(CameraError):
            for _ in range(20):
                pipes.receive(3, limit=1000)
            raise AssertionError("20 containers were read from arbitrary bytes")

    @given(
        head=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 2**16 - 1)),
        tail=st.binary(max_size=80),
    )
    def test_a_wrong_length_costs_few_and_small_reads(
        self, head: tuple[int, int, int], tail: bytes
    ) -> None:
        pipes, device = transport([struct.pack("<IHHI", *head, 3) + tail])
        with suppress(CameraError):
            pipes.receive(3, limit=1 << 20)
        assert len(device.bulk_in.reads) <= 3  # two packets, and the time-out
        assert max(device.bulk_in.reads) <= 1 << 20

    @pytest.mark.parametrize("ending", [[], [b""]], ids=["no empty packet", "empty packet"])
    def test_data_that_ends_with_a_full_packet_may_be_closed_with_an_empty_one(
        self, ending: list[bytes]
    ) -> None:
        whole = container(DATA, 0x1009, 3, bytes(3 * PACKET - 12))
        pipes, _ = transport([whole, *ending, RESPONSE_3])
        assert len(pipes.receive(3, limit=1000).payload) == 3 * PACKET - 12
        assert pipes.receive(3, limit=0).code == OK

    def test_no_read_is_smaller_than_a_packet(self) -> None:
        """A longer packet would be an overflow, and its data lost."""
        pipes, device = transport([container(DATA, 0x1009, 3, bytes(1000)), RESPONSE_3])
        pipes.receive(3, limit=1000)
        assert all(size % PACKET == 0 for size in device.bulk_in.reads)

    def test_containers_of_earlier_transactions_are_discarded(self) -> None:
        earlier = [container(RESPONSE, 0x2002, 1), container(DATA, 1, 2, b"x")]
        pipes, _ = transport([*earlier, RESPONSE_3])
        assert pipes.receive(3, limit=100).code == OK

    def test_containers_of_earlier_transactions_are_discarded_up_to_a_limit(self) -> None:
        pipes, device = transport([container(RESPONSE, OK, 1)] * 1000)
        with pytest.raises(CameraProtocolError, match="transaction 1 instead of 3"):
            pipes.receive(3, limit=100)
        assert len(device.bulk_in.reads) < 20

    def test_a_container_of_a_later_transaction_is_an_error(self) -> None:
        pipes, _ = transport([container(RESPONSE, OK, 4)])
        with pytest.raises(CameraProtocolError, match="transaction 4 instead of 3"):
            pipes.receive(3, limit=100)

    def test_data_cut_short_by_the_response_has_its_own_error(self) -> None:
        whole = container(DATA, 0x1009, 3, bytes(500))
        pipes, _ = transport([whole[:300], RESPONSE_3])
        with pytest.raises(IncompleteDataError, match="sent 300 of 512 bytes"):
            pipes.receive(3, limit=1000)
        assert pipes.receive(3, limit=0).code == OK


class TestSending:
    def test_a_transfer_of_full_packets_is_closed_with_an_empty_one(self) -> None:
        pipes, device = transport()
        pipes.send(0x1016, 1, (), bytes(PACKET - 12))
        pipes.send(0x1016, 2, (), bytes(4))
        assert [len(data) for data in device.bulk_out.sent] == [12, PACKET, 0, 12, 16]


class TestRecovery:
    def test_it_cancels_drains_and_asks_for_the_status(self) -> None:
        pipes, device = transport([b"rest of a file", b"more"])
        assert pipes.recover(7)
        assert device.controls == [(0x21, 0x64), (0xA1, 0x67)]
        assert device.bulk_in.transfers == []

    def test_a_camera_that_stays_busy_is_given_up_after_5_s(self) -> None:
        device, clock = Device(), VirtualClock()
        pipes = UsbTransport(device, "the camera", clock)
        device.status = struct.pack("<HH", 4, BUSY)
        assert not pipes.recover(7)
        assert clock.now() == pytest.approx(5.0, abs=0.1)


class TestEvents:
    @given(data=st.binary(max_size=40))
    @settings(max_examples=100)
    def test_invalid_events_are_ignored(self, data: bytes) -> None:
        pipes, device = transport()
        device.events.transfers = [data]
        event = pipes.event(0.001)
        assert event is None or event.kind == 4

    def test_an_event_has_its_code_and_parameters(self) -> None:
        pipes, device = transport()
        device.events.transfers = [container(4, 0x4002, 0, struct.pack("<I", 99))]
        event = pipes.event(0.001)
        assert event is not None
        assert (event.code, event.parameters) == (0x4002, (99,))
        assert pipes.event(0.001) is None

    def test_without_an_event_endpoint_the_wait_takes_its_time(self) -> None:
        device, clock = Device(), VirtualClock()
        device.interface.endpoints.remove(device.events)
        assert UsbTransport(device, "the camera", clock).event(0.25) is None
        assert clock.now() == 0.25

    def test_an_error_of_the_event_endpoint_is_no_event(self) -> None:
        pipes, device = transport()
        device.events.transfers = [errno.EPIPE, container(4, 0x4002, 0)]
        assert pipes.event(0.001) is None
        assert pipes.event(0.001) is not None


class TestInterface:
    def test_a_device_without_a_configuration_gets_one(self) -> None:
        device = Device()
        device.is_configured = False
        UsbTransport(device, "the camera", VirtualClock())
        assert device.times_configured == 1

    def test_a_device_without_a_still_image_interface_is_an_error(self) -> None:
        device = Device()
        device.interface.bInterfaceClass = 8
        with pytest.raises(CameraNotFoundError, match="the stick has no still-image interface"):
            UsbTransport(device, "the stick", VirtualClock())
