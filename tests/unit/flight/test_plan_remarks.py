"""What a `.plan` says in vain is told: what would change the flight, and words nearly right."""

from __future__ import annotations

import json
from typing import Any

import pytest

from saflite.contract.test_case import Mission
from saflite.flight.mission import builtin_mission, dump_plan, mission_names, parse_plan
from saflite.flight.plan_remarks import TOLD_MAX, plan_remarks


def told(document: dict[str, Any]) -> tuple[str, ...]:
    return plan_remarks(parse_plan(json.dumps(document), "x.plan"), "x.plan")


@pytest.fixture
def plan() -> dict[str, Any]:
    document: dict[str, Any] = json.loads(dump_plan(builtin_mission("mission2")))
    return document


@pytest.mark.parametrize("name", mission_names())
def test_nothing_is_told_of_the_plans_that_ship(name: str) -> None:
    assert plan_remarks(builtin_mission(name), name) == ()


def test_nothing_is_told_of_speeds_that_no_vehicle_is_sent_and_of_notes(plan: dict[str, Any]) -> None:
    plan["mission"] |= {"hoverSpeed": 12, "cruiseSpeed": 30, "firmwareType": 3, "globalPlanAltitudeMode": 1}
    plan["author"] = plan["mission"]["author"] = plan["mission"]["items"][0]["author"] = "me"
    assert told(plan) == ()


@pytest.mark.parametrize(
    ("outer", "words"),
    [
        ({"geoFence": {"circles": [{"circle": {"radius": 5}}], "polygons": [], "version": 2}}, "`geoFence` (circles)"),
        ({"geoFence": {"circles": [], "polygons": [{"inclusion": True}], "version": 2}}, "`geoFence` (polygons)"),
        ({"geoFence": {"polygon": [[47.0, 8.0]], "version": 1}}, "`geoFence` (polygon)"),
        ({"rallyPoints": {"points": [[47.0, 8.0, 50.0]], "version": 2}}, "`rallyPoints` are not flown"),
        ({"geofence": {}}, "`geofence` is unknown and not flown; did you mean `geoFence`?"),
        ({"rallypoints": []}, "did you mean `rallyPoints`?"),
        ({"plannedHomePosition": [1, 2, 3]}, "did you mean `mission.plannedHomePosition`?"),
    ],
)
def test_what_stands_beside_the_mission_is_told(outer: dict[str, Any], words: str, plan: dict[str, Any]) -> None:
    (found,) = told(plan | outer)
    assert found.startswith("x.plan: ")
    assert words in found


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ({"vehicleType": 1}, "`mission.vehicleType` 1 is no multicopter"),
        ({"vehicleType": 20}, "`mission.vehicleType` 20 is no multicopter"),
        ({"vehicletype": 2}, "`mission.vehicletype` is unknown and not flown; did you mean `vehicleType`?"),
        ({"geoFence": {"circles": [1]}}, "`mission.geoFence` is unknown and not flown; did you mean `geoFence`?"),
    ],
)
def test_what_stands_before_the_items_is_told(head: dict[str, Any], words: str, plan: dict[str, Any]) -> None:
    plan["mission"] |= head
    (found,) = told(plan)
    assert words in found


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ({"autoContinue": False}, "`autoContinue` false of mission.items[1] and 1 more is not flown"),
        ({"Frame": 0}, "`Frame` of mission.items[1] and 1 more is unknown and not flown; did you mean `frame`?"),
        ({"param": [1, 2]}, "`param` of mission.items[1] and 1 more is unknown and not flown; did you mean `params`?"),
    ],
)
def test_what_items_say_in_vain_is_told_once(extra: dict[str, Any], words: str, plan: dict[str, Any]) -> None:
    for item in plan["mission"]["items"][1:3]:
        item |= extra
    (found,) = told(plan)
    assert words in found


def test_of_endless_words_some_are_told_and_the_others_counted(plan: dict[str, Any]) -> None:
    found = told(plan | {f"geoFence{number}": 1 for number in range(100)})
    assert len(found) == TOLD_MAX + 1
    assert "80 more" in found[-1]


@pytest.mark.parametrize(
    "extra", ["{", "[]", "3", '{"mission": 3, "_items_extra": [1], "geoFence": 7, "rallyPoints": []}']
)
def test_a_mission_of_elsewhere_may_keep_anything(extra: str) -> None:
    mission = Mission(name="m", home_lat_deg=0.0, home_lon_deg=0.0, home_alt_m=0.0, items=(), plan_extra=extra)
    assert plan_remarks(mission, "x.json") == ()
