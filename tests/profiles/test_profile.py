"""Profiles: written atomically, found by serial number, safe against concurrent changes."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from camctl.errors import CamctlError, DataError, StorageError, UsageError
from camctl.interface.camera import CameraInfo
from camctl.interface.controls import Layout
from camctl.profiles.folder import list_profiles, remove_profile
from camctl.profiles.profile import (
    DelayRecord,
    Profile,
    StillRecord,
    change_profile,
    load_profile,
    profile_directory,
    save_profile,
)

THE_CAMERA = CameraInfo("v4l2:/dev/video0", "Make", "Webcam 3000", "A1B2", "v4l2")
DELAY = DelayRecord(
    frames=2, smallest=2, largest=2, trials=12, measured_at="2026-01-02T03:04:05+00:00"
)
STILL = StillRecord(rows=4, columns=6, layout=Layout.RGGB, bits=14, black=1024, white=16300)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "profiles"
    monkeypatch.setenv("CAMCTL_PROFILES", str(folder))
    return folder


def other_camera(**changes: str) -> CameraInfo:
    known = {"id": "x", "make": "Make", "model": "Webcam 3000", "serial": "A1B2", "driver": "v4l2"}
    return CameraInfo(**{**known, **changes})


def test_profile_of_a_new_camera_is_empty_and_writes_no_file(folder: Path) -> None:
    profile = load_profile(THE_CAMERA)
    assert (profile.driver, profile.make, profile.model, profile.serial) == (
        "v4l2",
        "Make",
        "Webcam 3000",
        "A1B2",
    )
    assert (profile.delays, profile.stills) == ({}, {})
    assert not folder.exists()


def test_saved_profile_is_found_on_another_port(folder: Path) -> None:
    profile = load_profile(THE_CAMERA)
    profile.delays["YUYV-640x480-30"] = DELAY
    profile.stills["raw"] = STILL
    path = save_profile(profile)
    assert path.parent == folder
    assert load_profile(other_camera(id="v4l2:/dev/video7")) == profile


def test_each_camera_has_its_own_profile() -> None:
    change_profile(THE_CAMERA, lambda profile: profile.delays.update(mode=DELAY))
    for other in (
        other_camera(serial="A1B3"),
        other_camera(serial=""),
        other_camera(serial="a1b2"),
        other_camera(make="Makes"),
        other_camera(model="Webcam 3000-A1B2", serial=""),
        other_camera(driver="ptp"),
    ):
        assert load_profile(other).delays == {}


def test_cameras_of_a_model_without_serial_numbers_share_a_profile() -> None:
    change_profile(other_camera(serial=""), lambda profile: profile.delays.update(mode=DELAY))
    assert load_profile(other_camera(serial="", id="y")).delays == {"mode": DELAY}


@given(
    st.builds(
        CameraInfo,
        id=st.just("x"),
        make=st.text(max_size=300),
        model=st.text(alphabet=st.characters() | st.sampled_from("/\\.\0\n\ud800 "), max_size=300),
        serial=st.sampled_from(["", "..", "../../x", "/etc/passwd", "\udcff", "COM1", "ä" * 300]),
        driver=st.sampled_from(["v4l2", "ptp"]),
    )
)
def test_any_identity_gives_a_file_name_in_the_folder(camera: CameraInfo) -> None:
    path = change_profile(camera, lambda profile: profile.delays.update({camera.make: DELAY}))
    assert path.parent == profile_directory()
    assert path.name.isascii()
    assert len(path.name) < 120
    assert list(load_profile(camera).delays.values()) == [DELAY]
    path.unlink()


def test_failed_write_keeps_the_earlier_profile(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_profile(THE_CAMERA, lambda profile: profile.delays.update(mode=DELAY))

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="disk is full"):
        change_profile(THE_CAMERA, lambda profile: profile.delays.clear())
    assert load_profile(THE_CAMERA).delays == {"mode": DELAY}
    assert [path.name for path in folder.iterdir() if "part" in path.name] == []


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"\xff\xfe",
        b'{"driver": "v4l2"}',
        b'{"driver": "v4l2", "make": "", "model": "", "serial": "", "extra": 1}',
    ],
)
def test_damaged_file_is_an_error_whose_remedy_is_to_remove_it(content: bytes) -> None:
    path = change_profile(THE_CAMERA, lambda profile: None)
    path.write_bytes(content)
    for read in (lambda: load_profile(THE_CAMERA), list_profiles):
        with pytest.raises(DataError) as error:
            read()
        assert "\n" not in str(error.value)
        assert error.value.remedies == {"profile_remove": path.stem}
    remove_profile(path.stem)
    assert load_profile(THE_CAMERA).delays == {}


def test_profile_of_another_camera_is_refused() -> None:
    path = change_profile(THE_CAMERA, lambda profile: profile.delays.update(mode=DELAY))
    other = path.parent / f"{load_profile(other_camera(serial='B')).name}.json"
    path.rename(other)
    with pytest.raises(DataError, match="is the profile of another camera"):
        load_profile(other_camera(serial="B"))


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": 3},
        {"frames": None},
        {"smallest": 1},
        {"smallest": 4, "frames": None},
        {"smallest": -2, "frames": None},
        {"time": (3, 2)},
        {"gain": (0, 30), "frames": None},
        {"trials": 0},
    ],
)
def test_contradicting_fields_of_a_delay_are_refused(changes: dict[str, int | None]) -> None:
    with pytest.raises(ValidationError):
        DelayRecord.model_validate({**DELAY.model_dump(), **changes})


def test_delay_that_is_not_constant_has_no_number_of_frames() -> None:
    varied = {**DELAY.model_dump(), "frames": None, "smallest": 1, "largest": 3}
    assert DelayRecord.model_validate(varied).frames is None


@pytest.mark.parametrize("changes", [{"black": 16300}, {"white": 1 << 14}, {"rows": 0}])
def test_contradicting_fields_of_a_still_format_are_refused(changes: dict[str, int]) -> None:
    with pytest.raises(ValidationError):
        StillRecord.model_validate({**STILL.model_dump(), **changes})


def test_concurrent_changes_are_all_kept() -> None:
    problems: list[BaseException] = []

    def add_delay(mode: str) -> None:
        try:
            change_profile(THE_CAMERA, lambda profile: profile.delays.update({mode: DELAY}))
        except BaseException as error:
            problems.append(error)

    modes = [f"mode-{number}" for number in range(12)]
    threads = [threading.Thread(target=add_delay, args=(mode,)) for mode in modes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems == []
    assert sorted(load_profile(THE_CAMERA).delays) == sorted(modes)


def test_profiles_are_listed_and_removed() -> None:
    assert list_profiles() == []
    for serial in ("1", "2"):
        change_profile(
            other_camera(serial=serial), lambda profile: profile.delays.update(mode=DELAY)
        )
    first, second = list_profiles()
    assert {first.serial, second.serial} == {"1", "2"}
    assert not remove_profile(first.name).exists()
    assert list_profiles() == [second]
    with pytest.raises(UsageError, match="did you mean"):
        remove_profile(second.name[:-1])
    remove_profile(second.name)
    with pytest.raises(UsageError, match=r"unknown profile .*: there are no profiles") as caught:
        remove_profile(second.name)
    assert caught.value.remedies == {"calibrate_all": None}


@pytest.mark.parametrize("name", ["..", "../secret", "", "*"])
def test_remove_touches_only_profiles(folder: Path, name: str) -> None:
    path = change_profile(THE_CAMERA, lambda profile: None)
    secret = folder.parent / "secret.json"
    secret.write_text("{}")
    with pytest.raises(UsageError):
        remove_profile(name)
    assert secret.exists()
    assert path.exists()


def test_file_in_place_of_the_folder_holds_no_profile_and_takes_none(folder: Path) -> None:
    folder.write_text("no folder")
    assert load_profile(THE_CAMERA).delays == {}
    assert list_profiles() == []
    with pytest.raises(CamctlError, match="CAMCTL_PROFILES"):
        save_profile(Profile(driver="a", make="b", model="c", serial="d"))
    with pytest.raises(CamctlError, match="CAMCTL_PROFILES"):
        change_profile(THE_CAMERA, lambda profile: None)


def test_missing_permission_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = change_profile(THE_CAMERA, lambda profile: None)
    if os.geteuid() != 0:
        path.chmod(0)
    else:  # nothing is forbidden to root

        def forbidden(_path: str, _flags: int) -> int:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(os, "open", forbidden)
    with pytest.raises(DataError, match="Permission denied"):
        load_profile(THE_CAMERA)


def test_profiles_are_in_the_users_data_folder_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CAMCTL_PROFILES")
    monkeypatch.setenv("XDG_DATA_HOME", "/somewhere")
    assert profile_directory() == Path("/somewhere/camctl/profiles")
