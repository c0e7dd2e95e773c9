"""Containers cut in every way that USB allows, on pipes of paper."""

import errno
import struct
import time
from array import array
from contextlib import suppress
from itertools import pairwise

import pytest
import usb.core
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.ptp.transport import DATA, RESPONSE, HalfSentError, UsbTransport

PACKET = 64
OK = 0x2001


class Pipe:
    """One endpoint: gives transfers one by one, as cut."""

    wMaxPacketSize = PACKET  # noqa: N815

    def __init__(self, address, attributes):
        self.bEndpointAddress, self.bmAttributes = address, attributes
        self.transfers, self.sent, self.reads = [], [], []

    def read(self, size, timeout):
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

    def write(self, data, timeout):
        self.sent.append(bytes(data))
        return len(data)

    def clear_halt(self):
        pass


class Interface:
    bInterfaceClass, bInterfaceSubClass, bInterfaceProtocol = 6, 1, 1  # noqa: N815
    bInterfaceNumber = 0  # noqa: N815

    def __init__(self, pipes):
        self.pipes = pipes

    def __iter__(self):
        return iter(self.pipes)


class Context:
    def managed_claim_interface(self, device, number):
        pass

    managed_release_interface = managed_claim_interface

    def dispose(self, device):
        pass


class Device:
    def __init__(self):
        self.bulk_in, self.bulk_out, self.events = Pipe(0x81, 2), Pipe(0x02, 2), Pipe(0x83, 3)
        self._ctx = Context()
        self.interface = Interface([self.bulk_in, self.bulk_out, self.events])
        self.controls, self.status = [], struct.pack("<HH", 4, OK)
        self.configured = 0

    def get_active_configuration(self):
        return [self.interface]

    def set_configuration(self):
        self.configured += 1

    def is_kernel_driver_active(self, number):
        raise NotImplementedError

    def ctrl_transfer(self, kind, request, value, index, data, timeout):
        self.controls.append((kind, request))
        return array("B", self.status) if kind & 0x80 else len(data)


def transport(transfers=()):
    device = Device()
    device.bulk_in.transfers = list(transfers)
    return UsbTransport(device, "the camera"), device


def container(kind, code, number, payload=b"", length=None):
    size = 12 + len(payload) if length is None else length
    return struct.pack("<IHHI", size, kind, code, number) + payload


RESPONSE_3 = container(RESPONSE, OK, 3)


@given(
    payload=st.binary(max_size=400),
    cuts=st.lists(st.integers(1, 500), max_size=6),
    empty=st.lists(st.booleans(), min_size=8, max_size=8),
    merged=st.booleans(),
)
@settings(max_examples=300)
def test_data_arrives_however_it_is_cut(payload, cuts, empty, merged):
    whole = container(DATA, 0x1009, 3, payload)
    edges = sorted({0, len(whole), *(c for c in cuts if c < len(whole))})
    pieces = [whole[a:b] for a, b in pairwise(edges)]
    if merged:
        pieces[-1] += RESPONSE_3
    else:
        pieces.append(RESPONSE_3)
    transfers = []
    for piece, is_empty in zip(pieces, [*empty, *[False] * 9], strict=False):
        transfers += [b"", piece] if is_empty else [piece]
    pipes, _ = transport(transfers)
    assert pipes.receive(3, limit=1000).payload == payload
    assert pipes.receive(3, limit=0).code == OK


@given(transfers=st.lists(st.binary(max_size=100) | st.just(b""), max_size=20))
@settings(max_examples=300)
def test_rubbish_ends_in_a_typed_error(transfers):
    pipes, _ = transport(transfers)
    with suppress(CameraError):
        for _ in range(20):
            pipes.receive(3, limit=1000)
        raise AssertionError("it ran out of rubbish without a word")


@given(
    head=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 2**16 - 1)),
    tail=st.binary(max_size=80),
)
@settings(max_examples=200)
def test_a_header_that_lies_takes_neither_time_nor_memory(head, tail):
    pipes, device = transport([struct.pack("<IHHI", *head, 3) + tail])
    began = time.monotonic()
    with suppress(CameraError):
        pipes.receive(3, limit=1 << 20)
    assert time.monotonic() - began < 0.2
    assert max(device.bulk_in.reads) <= 1 << 20


def test_an_empty_packet_closes_what_ends_with_a_full_one():
    pipes, device = transport()
    pipes.send_data(0x1016, 1, bytes(PACKET - 12))
    pipes.send_data(0x1016, 1, bytes(4))
    assert [len(data) for data in device.bulk_out.sent] == [PACKET, 0, 16]


def test_what_ends_with_a_full_packet_needs_no_empty_one_after_it():
    for ending in ([], [b""]):
        whole = container(DATA, 0x1009, 3, bytes(3 * PACKET - 12))
        pipes, _ = transport([whole, *ending, RESPONSE_3])
        assert len(pipes.receive(3, limit=1000).payload) == 3 * PACKET - 12
        assert pipes.receive(3, limit=0).code == OK


def test_no_read_is_smaller_than_a_packet():
    pipes, device = transport([container(DATA, 0x1009, 3, bytes(1000)), RESPONSE_3])
    pipes.receive(3, limit=1000)
    assert all(size % PACKET == 0 for size in device.bulk_in.reads)


def test_answers_to_what_was_given_up_are_passed_over():
    pipes, _ = transport([container(RESPONSE, 0x2002, 1), container(DATA, 1, 2, b"x"), RESPONSE_3])
    assert pipes.receive(3, limit=100).code == OK


def test_an_answer_to_what_was_never_asked_is_nonsense():
    pipes, _ = transport([container(RESPONSE, OK, 4)])
    with pytest.raises(CameraProtocolError, match="transaction 4"):
        pipes.receive(3, limit=100)


def test_answers_to_old_transactions_do_not_go_on_for_ever():
    pipes, _ = transport([container(RESPONSE, OK, 1)] * 1000)
    with pytest.raises(CameraProtocolError):
        pipes.receive(3, limit=100)


def test_half_a_container_and_a_response_is_told_as_such():
    whole = container(DATA, 0x1009, 3, bytes(500))
    pipes, _ = transport([whole[:300], RESPONSE_3])
    with pytest.raises(HalfSentError):
        pipes.receive(3, limit=1000)
    assert pipes.receive(3, limit=0).code == OK


def test_silence_and_the_plug_are_told_apart():
    pipes, _ = transport([])
    with pytest.raises(CameraTimeoutError):
        pipes.receive(3, limit=10)
    pipes, _ = transport([errno.ENODEV])
    with pytest.raises(CameraDisconnectedError):
        pipes.receive(3, limit=10)


def test_recovery_cancels_clears_and_asks():
    pipes, device = transport([b"left over", b"more"])
    assert pipes.recover(7)
    assert device.controls == [(0x21, 0x64), (0xA1, 0x67)]
    assert device.bulk_in.transfers == []


def test_recovery_of_a_camera_that_stays_busy_gives_up(monkeypatch):
    monkeypatch.setattr("drivers.ptp.transport._RECOVERY_S", 0.2)
    pipes, device = transport()
    device.status = struct.pack("<HH", 4, 0x2019)
    began = time.monotonic()
    assert not pipes.recover(7)
    assert time.monotonic() - began < 1


@given(data=st.binary(max_size=40))
@settings(max_examples=100)
def test_events_that_make_no_sense_are_none(data):
    pipes, device = transport()
    device.events.transfers = [data]
    event = pipes.event(0.001)
    assert event is None or event.kind == 4


def test_an_event_is_heard():
    pipes, device = transport()
    device.events.transfers = [container(4, 0x4002, 0, struct.pack("<I", 99))]
    event = pipes.event(0.001)
    assert (event.code, event.parameters) == (0x4002, (99,))
    assert pipes.event(0.001) is None


def test_a_configuration_that_is_set_is_not_set_again():
    _, device = transport()
    assert device.configured == 0


def test_what_is_no_still_camera_is_told():
    device = Device()
    device.interface.bInterfaceClass = 8
    with pytest.raises(CameraNotFoundError, match="not a still camera"):
        UsbTransport(device, "the stick")
