"""What all tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture
def real_data():
    """The folder of real data: $CAMCTL_DATA, else ../shared/data beside the project."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CAMCTL_DATA", beside))
    if not folder.is_dir():
        pytest.skip("real data not present: set CAMCTL_DATA to its folder")
    return folder


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Solved exposures and camera profiles of the tests go to folders of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        patch.setenv("CAMCTL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
