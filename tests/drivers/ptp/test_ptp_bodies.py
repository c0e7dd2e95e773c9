"""Recorded bodies of seven makers: each takes the pictures of its settings, or says why not.

The table of docs/reference/bodies.md says what is expected of each body.
`docs/print_bodies.py` prints it.
"""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from ptp_bodies import row, turned_to_manual, why_refused
from sampling import some

from camctl.sim.devices.ptp.body_facts import MAKERS, bodies, load_body
from camctl.sim.devices.ptp.nikon import NikonResponder
from camctl.sim.devices.ptp.protocol import Response
from camctl.sim.devices.ptp.responder import Responder

pytestmark = pytest.mark.usefixtures("own_profiles")
PAGE = Path(__file__).parents[3] / "docs/reference/bodies.md"


@cache
def expected() -> dict[str, str]:
    """Return the rows of the table by the name of the body."""
    rows = (line for line in PAGE.read_text("utf-8").splitlines() if "| `" in line)
    return {line.split("|")[2].strip().strip("`"): line for line in rows}


def test_30_recorded_bodies_of_all_makers_shoot_or_are_refused_with_the_reason() -> None:
    one_of_each = {maker: name for name, (maker, *_) in bodies().items()}
    assert set(one_of_each) == set(MAKERS)
    some = {*list(bodies())[::9], *one_of_each.values()}
    assert len(some) >= 30
    assert {name: row(name) for name in some} == {name: expected()[name] for name in some}


@pytest.mark.slow
def test_every_recorded_body_shoots_or_is_refused_with_the_reason() -> None:
    assert {name: row(name) for name in bodies()} == expected()


def test_why_bodies_are_refused_is_counted_on_the_page() -> None:
    refused = [name for name, line in expected().items() if "| shoots: " not in line]
    counted = Counter(map(why_refused, refused))
    lines = PAGE.read_text("utf-8").splitlines()
    assert sum(counted.values()) == len(refused)
    for why, count in counted.items():
        assert [line for line in lines if line.startswith(f"| {why} | {count} |")]


def test_at_least_60_bodies_and_two_of_each_maker_with_remote_control_shoot() -> None:
    shooting = [name for name, line in expected().items() if "| shoots: " in line]
    makers = Counter(bodies()[name][0] for name in shooting)
    assert len(shooting) >= 150
    assert all(makers[maker] >= 2 for maker in MAKERS if maker != "pentax")


def test_no_body_is_refused_for_the_access_to_its_card() -> None:
    """35 of 37 Nikon bodies are read-only with deletion."""
    with_deletion = [name for name in bodies() if load_body(name).access == 2]
    assert len(with_deletion) > 50
    assert not [name for name in with_deletion if "write-protected" in expected()[name]]


def test_nikons_with_hidden_properties_have_their_exact_times() -> None:
    hiding = [name for name in bodies() if 0xD100 in load_body(name).hidden]
    assert len(hiding) >= 35
    shooting = [name for name in hiding if "| shoots: " in expected()[name]]
    assert len(shooting) >= 35
    assert not [name for name in shooting if "1/2000 to" in expected()[name]]


@pytest.mark.parametrize(
    "name", some(["nikon-d850", "canon-eos7d", "sony-a1m2", "olympus-e-m1"], every=4)
)
def test_a_body_that_ignores_its_settings_is_found_out(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checks can fail: a body that accepts each value and keeps its own."""
    assert not turned_to_manual(name).refusal
    monkeypatch.setattr(Responder, "set_number", lambda *_: Response.OK)
    refusal = turned_to_manual(name).refusal
    assert re.search("cannot set|does not report the", refusal), refusal


def test_a_body_that_exposes_for_another_time_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = NikonResponder.exposure_time_s
    monkeypatch.setattr(
        NikonResponder, "exposure_time_s", lambda responder: 1.1 * (exact(responder) or 1.0)
    )
    with pytest.raises(AssertionError, match="time_s"):
        turned_to_manual("nikon-d850")


def test_the_numbers_in_the_pages_are_those_of_the_table() -> None:
    rows = expected()
    assert list(rows) == list(bodies())
    shooting = Counter(bodies()[name][0] for name, line in rows.items() if "| shoots: " in line)
    together = Counter(maker for maker, _ in bodies().values())
    page, cameras = PAGE.read_text("utf-8"), (PAGE.parent / "cameras.md").read_text("utf-8")
    assert f"| together | {len(rows)} | {sum(shooting.values())} |" in page
    assert f"{sum(shooting.values())} of {len(rows)} recorded bodies" in cameras
    for maker, count in shooting.items():
        assert f" | {together[maker]} | {count} | " in page
        assert re.search(rf"{maker}[\w ]*? {count}\b", cameras, re.IGNORECASE), maker
