"""USB devices through pyusb: errors of libusb, and identities with unreadable strings."""

from __future__ import annotations

import errno
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import usb.core
import usb.util

from camctl.drivers.common.device_holders import Holder, holding
from camctl.drivers.common.usb import (
    UDEV_RULES,
    StalledError,
    claim_interface,
    device_name,
    usb_error,
    usb_identity,
)
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)


class Device:
    """The descriptors of a device at 3:7 with strings 1 to 3."""

    idVendor, idProduct = 0x04B0, 0x0428  # noqa: N815 - pyusb's names
    iManufacturer, iProduct, iSerialNumber = 1, 2, 3  # noqa: N815
    bus, address, port_numbers = 3, 7, (1, 4)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="the system has no /proc")
def test_a_program_that_holds_a_camera_is_named_in_full(tmp_path: Path) -> None:
    """The kernel's own name of it ends after 15 characters."""
    node, program = tmp_path / "001", tmp_path / "gvfs-gphoto2-volume-monitor"
    node.touch()
    shutil.copy(shutil.which("sleep") or "/bin/sleep", program)
    with node.open() as file, subprocess.Popen([program, "60"], stdin=file) as process:
        try:
            found = [each for each in holding(str(node)) if not each.is_us]
        finally:
            process.kill()
    assert found == [Holder(process.pid, program.name)]


def test_a_camera_claimed_by_the_desktop_names_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monitor = Holder(4711, "gvfs-gphoto2-volume-monitor")

    class Claimed(Device):
        def is_kernel_driver_active(self, number: int) -> bool:
            return False

    def claim(*_: object) -> None:
        raise usb.core.USBError("Resource busy", -6, errno.EBUSY)

    monkeypatch.setattr(usb.util, "claim_interface", claim)
    monkeypatch.setattr("camctl.drivers.common.usb.holding", lambda node: iter([monitor]))
    message = r"by another program: gvfs-gphoto2-volume-monitor \(process 4711\); .*unmount it"
    with pytest.raises(CameraBusyError, match=message):
        claim_interface(Claimed(), 0, "the camera")


class TestUsbErrors:
    @pytest.mark.parametrize(
        ("number", "kind", "message"),
        [
            (
                errno.EACCES,
                CameraNotFoundError,
                "the camera cannot be opened: no permission; install",
            ),
            (errno.EBUSY, CameraBusyError, "the camera is in use by another program; desktops"),
            (errno.ENODEV, CameraDisconnectedError, "the camera was disconnected; plug it in"),
            (errno.EPROTO, CameraDisconnectedError, "the camera lost its USB signal; plug it in"),
            (errno.ETIMEDOUT, CameraTimeoutError, "the camera does not answer; switch it off"),
            (errno.EPIPE, StalledError, "the camera refused a USB transfer (stall); try again"),
            (errno.EOVERFLOW, CameraProtocolError, "the camera sent more than was requested; try"),
            (None, CameraProtocolError, "the camera failed a USB transfer: it says; plug it in"),
        ],
    )
    def test_each_error_has_a_type_and_one_line_with_a_remedy(
        self, number: int | None, kind: type[CameraError], message: str
    ) -> None:
        error = usb_error(usb.core.USBError("it says", -1, number), "the camera")
        assert type(error) is kind
        assert str(error).startswith(message)
        assert error.hint
        assert ("udev_rules" in error.remedies) == (number == errno.EACCES)
        assert "\n" not in str(error)

    def test_udev_rules_name_the_class_of_still_cameras(self) -> None:
        assert "060101" in UDEV_RULES
        assert all(
            line.startswith(("#", "ACTION", "SUBSYSTEM", "MODE", "LABEL", "TAG"))
            for line in UDEV_RULES.strip().splitlines()
        )


class TestIdentity:
    def read_strings(self, monkeypatch: pytest.MonkeyPatch, *strings: Any) -> None:
        """Let pyusb read these strings; an exception is raised instead."""

        def get_string(_: object, index: int) -> Any:
            string = strings[index - 1]
            if isinstance(string, Exception):
                raise string
            return string

        monkeypatch.setattr(usb.util, "get_string", get_string)

    def test_the_id_is_the_serial_number(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.read_strings(monkeypatch, "Maker\0\n", " Model ", "A77")
        info = usb_identity(Device())
        assert (info.id, info.make, info.model, info.serial) == ("ptp:A77", "Maker", "Model", "A77")

    def test_a_serial_number_like_an_address_is_not_used_as_id(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.read_strings(monkeypatch, "Maker", "Model", "1:2")
        assert usb_identity(Device()).id == "ptp:003:007"

    @pytest.mark.parametrize(
        "error",
        [usb.core.USBError("Pipe error", -9, errno.EPIPE), NotImplementedError()],
        ids=["stall", "not supported"],
    )
    def test_unreadable_strings_are_replaced_by_numbers(
        self, monkeypatch: pytest.MonkeyPatch, error: Exception
    ) -> None:
        self.read_strings(monkeypatch, error, error, error)
        info = usb_identity(Device())
        assert (info.id, info.serial) == ("ptp:003:007", "")
        assert (info.make, info.model) == ("USB vendor 04b0", "product 0428")
        assert device_name(Device()) == "the camera at USB 003:007"

    def test_without_permission_the_strings_of_the_kernel_are_used(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        denied = ValueError("The device has no langid (permission issue, no string descriptors)")
        self.read_strings(monkeypatch, denied, denied, denied)
        monkeypatch.setattr("camctl.drivers.common.usb._SYSFS", tmp_path)
        (tmp_path / "3-1.4").mkdir()
        (tmp_path / "3-1.4" / "serial").write_text("A77\n")
        info = usb_identity(Device())
        assert (info.id, info.model) == ("ptp:A77", "product 0428")
