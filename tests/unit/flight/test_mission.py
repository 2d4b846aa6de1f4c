"""Plans are read and written without loss; built-in missions are where the competition put them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.test_case import Mission
from saflite.flight import mission


def item(**changes: Any) -> dict[str, Any]:
    params = [0, 0, 0, None, 47.3978, 8.5456, 10]
    base = {"type": "SimpleItem", "command": 16, "frame": 3, "params": params, "autoContinue": True, "doJumpId": 1}
    return {**base, **changes}


def plan(*items: dict[str, Any], **outer: Any) -> dict[str, Any]:
    inner = {"plannedHomePosition": [47.3977419, 8.5455938, 488.8], "items": list(items), "version": 2}
    return {"fileType": "Plan", "mission": inner, "version": 1, **outer}


def parse(document: dict[str, Any]) -> Mission:
    return mission.parse_plan(json.dumps(document), "x.plan")


OFFICIAL_M = {
    "mission1": [(0, 0, 10), (3.31, 53.10, 0)],
    "mission2": [(0, 0, 10), (-6.83, 53.98, 10), (-12.35, 0.14, 0)],
    "mission3": [(0, 0, 10), (3.31, 53.10, 10), (-14.69, 54.12, 10), (-17.86, 1.00, 0)],
    "mission4": [(0, 0, 10), (46.15, 50.98, 10), (35.08, 60.61, 10), (-17.86, 1.00, 0)],
    "mission5": [(0, 0, 10), (36.82, 28.13, 10), (-6.92, 50.00, 10), (-0.33, -0.05, 0)],
}


@pytest.mark.parametrize("name", sorted(OFFICIAL_M))
def test_built_in_missions_fly_the_published_way_points(name: str) -> None:
    places = mission.waypoints(mission.builtin_mission(name))
    assert [kind for kind, *_ in places][:: len(places) - 1] == ["takeoff", "land"]
    for place, expected in zip(places, OFFICIAL_M[name], strict=True):
        assert place[1:4] == pytest.approx(expected, abs=0.01)


def test_names_say_which_missions_are_stand_ins() -> None:
    names = mission.mission_names()
    assert names == (*sorted(OFFICIAL_M), "mission6-standin", "mission7-standin")


def test_unknown_mission_is_refused_with_the_choice() -> None:
    with pytest.raises(Refused, match="mission1, mission2"):
        mission.builtin_mission("mission9")


@pytest.mark.parametrize("name", mission.mission_names())
def test_writing_a_built_in_plan_loses_nothing(name: str) -> None:
    text = (mission.MISSIONS_DIR / f"{name}.plan").read_text()
    read = mission.builtin_mission(name)
    assert json.loads(mission.dump_plan(read)) == json.loads(text)
    assert mission.parse_plan(mission.dump_plan(read), "again", name) == read
    assert wire.decode(wire.encode(read), Mission) == read


numbers = st.integers(1 - 2**63, 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
anything = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
OURS = {"autoContinue", "command", "doJumpId", "frame", "params", "type", "fileType", "mission", "version"}
extras = st.dictionaries(st.text(min_size=1, max_size=6).filter(lambda key: key not in OURS), anything, max_size=4)


@example(outer={}, first={}, second={"0": 2**53 + 1}, inner={})
@given(outer=extras, first=extras, second=extras, inner=extras)
def test_unknown_content_is_kept(outer: Any, first: Any, second: Any, inner: Any) -> None:
    document = plan(item(**first), item(**second, doJumpId=2), **outer)
    document["mission"] |= {f"x{key}": value for key, value in inner.items()}
    read = parse(document)
    assert json.loads(mission.dump_plan(read)) == document
    assert wire.decode(wire.encode(read), Mission) == read


@pytest.mark.parametrize(
    ("document", "word"),
    [
        ({"fileType": "Mission"}, "fileType"),
        (plan(), "at least one item"),
        (plan({"type": "ComplexItem", "complexItemType": "survey"}), "ComplexItem survey"),
        (plan(item(params=[1, 2, 3])), r"items\[0\].params"),
        (plan(item(), item(command="take off")), r"items\[1\].command"),
        (plan(item(params=[0, 0, 0, True, 1, 2, 3])), "params"),
        ({**plan(item()), "mission": {"items": [item()], "plannedHomePosition": [1, 2]}}, "plannedHomePosition"),
    ],
)
def test_what_is_no_plan_is_refused(document: dict[str, Any], word: str) -> None:
    with pytest.raises(Refused, match=word) as refusal:
        parse(document)
    assert refusal.value.where == "x.plan"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"fileType": "Plan", "a": NaN}', "[" * 100_000])
def test_broken_json_is_refused(text: str) -> None:
    with pytest.raises(Refused):
        mission.parse_plan(text, "x.plan")


def test_broken_json_names_its_line() -> None:
    with pytest.raises(Refused, match="line 3"):
        mission.parse_plan('{\n"fileType": "Plan",\noops}', "x.plan")


def test_a_missing_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"no\.plan"):
        mission.load_plan(tmp_path / "no.plan")


def test_way_points_understand_frames_holds_and_missing_places() -> None:
    read = parse(
        plan(
            item(command=22, params=[0, 0, 0, None, None, None, 12]),
            item(command=530),
            item(command=19, params=[7, 0, 0, None, 47.3978, 8.5456, 500.8], frame=0),
            item(command=16, params=[0, 0, 0, None, 0, 0, 20]),
            item(command=20),
        )
    )
    takeoff, hold, same, back = mission.waypoints(read)
    assert [list(takeoff), list(back)] == [["takeoff", 0, 0, 12, 0], ["return", 0, 0, 0, 0]]
    assert hold.hold_s == 7
    assert hold.z_m == pytest.approx(12.0)
    assert (same.x_m, same.y_m, same.z_m) == (hold.x_m, hold.y_m, 20)


@pytest.mark.parametrize("changes", [{"command": 177}, {"command": 84}, {"frame": 1}])
def test_items_that_cannot_be_flown_are_refused(changes: dict[str, int]) -> None:
    with pytest.raises(Refused):
        mission.waypoints(parse(plan(item(**changes))))


@given(st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_local_and_geographic_are_inverse(x: float, y: float) -> None:
    there = mission.to_geographic(x, y, 47.3977419, 8.5455938)
    assert mission.to_local(*there, 47.3977419, 8.5455938) == pytest.approx((x, y), abs=1e-5)
