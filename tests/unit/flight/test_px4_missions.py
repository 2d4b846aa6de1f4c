"""Missions that somebody beside PX4 flies: our planner as companion, a pilot by the sticks. No autopilot is needed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.errors import Refused
from saflite.contract.test_case import Mission, MissionItem, Scenario, Stimulus, Target, TestCase
from saflite.flight.autopilots.external.link import TICK_S
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4 import modes
from saflite.flight.autopilots.px4.check import check_test_case
from saflite.flight.autopilots.px4.companion import Companion
from saflite.flight.autopilots.px4.mission import as_taken
from saflite.flight.autopilots.px4.pilot import Pilot
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mission import builtin_mission

LISTING = Listing(binary="0" * 64, parameters={})


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(np.zeros((0, 8)), 0.0, 1)


def place(north_m: float, east_m: float) -> Any:
    """Return the message of a place at 10 m."""
    return dialect.MAVLink_local_position_ned_message(0, north_m, east_m, -10.0, 0.0, 0.0, 0.0)


class Link:
    """A link that keeps what is sent."""

    def __init__(self) -> None:
        self.latest: dict[str, Any] = {"LOCAL_POSITION_NED": place(0.0, 0.0)}
        self.sent: list[Any] = []
        self.mav: Any = dialect.MAVLink(None)
        self.mav.send = lambda given, **_: self.sent.append(given)


def test_the_companion_takes_over_after_take_off_and_hands_back_for_the_landing(vehicle: Vehicle) -> None:
    """Flown by a vehicle that is where it was told to be."""
    link: Any = Link()
    sent = link.sent
    companion = Companion(builtin_mission("mission2"), np.zeros((0, 8)), vehicle, link)
    vehicle.set(armed=1.0, mission_item=1.0, altitude_m=10.0)
    companion.tick(0.0, TICK_S)
    assert sent == []  # PX4 takes off
    vehicle["mission_item"] = 2.0
    orders: list[Any] = []
    for tick in range(6000):
        companion.tick(tick * TICK_S, TICK_S)
        orders += [one for one in sent if one.get_type() == "COMMAND_LONG"]
        points = [one for one in sent if one.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        sent.clear()
        if not points:
            break
        (at,) = points
        vehicle.set(x_m=at.x, y_m=at.y, altitude_m=-at.z, yaw_rad=at.yaw)
        link.latest["LOCAL_POSITION_NED"] = at
    assert [(one.param2, one.param3) for one in orders] == [(modes.OFFBOARD, 0.0), (modes.AUTO, modes.LAND)]
    assert 500 < tick < 5999
    assert (vehicle["x_m"], vehicle["y_m"]) == pytest.approx((-12.4, 0.1), abs=3.0)


def test_a_pilot_leads_by_the_sticks_and_lets_go_before_the_landing(vehicle: Vehicle) -> None:
    """Flown by a vehicle that turns and moves as the sticks say."""
    link: Any = Link()
    sent = link.sent
    pulses_us = [1500] * 4
    pilot = Pilot(builtin_mission("mission2"), pulses_us, vehicle, link)
    vehicle.set(armed=1.0, mission_item=2.0, altitude_m=10.0)
    rested_s = 0.0
    for tick in range(6000):
        pilot.tick(tick * TICK_S, TICK_S)
        ahead_mps, turn_rps = (1500 - pulses_us[1]) / 70.0, (pulses_us[3] - 1500) / 500.0
        yaw_rad = vehicle["yaw_rad"] + TICK_S * turn_rps
        north, east = ahead_mps * np.cos(yaw_rad), ahead_mps * np.sin(yaw_rad)
        vehicle.set(x_m=vehicle["x_m"] + TICK_S * north, y_m=vehicle["y_m"] + TICK_S * east, yaw_rad=yaw_rad)
        link.latest["LOCAL_POSITION_NED"] = place(vehicle["x_m"], vehicle["y_m"])
        rested_s = rested_s + TICK_S if pulses_us == [1500] * 4 else 0.0
        if len(sent) == 2:
            break
    assert [(one.param2, one.param3) for one in sent] == [(modes.POSITION, 0.0), (modes.AUTO, modes.LAND)]
    assert rested_s == pytest.approx(1.0, abs=0.1)  # PX4 takes a stick that still moves for the pilot's will
    assert (vehicle["x_m"], vehicle["y_m"]) == pytest.approx((-12.4, 0.1), abs=3.0)


def test_a_pilot_holds_all_the_sticks() -> None:
    stick = Stimulus(at_s=1.0, kind="stick", name="RC1", values=(1600.0,))
    target = Target(name="px4", settings={"companion": "pilot"})
    flown = Scenario(mission=builtin_mission("mission2"))
    check_test_case(TestCase(target=target, scenario=flown), LISTING)
    with pytest.raises(Refused, match="the pilot holds them"):
        check_test_case(TestCase(target=target, scenario=flown, stimuli=(stick,)), LISTING)


def test_a_companion_needs_a_mission_to_fly() -> None:
    alone = TestCase(target=Target(name="px4", settings={"companion": "planner"}), scenario=Scenario())
    with pytest.raises(Refused, match="a mission for it to fly"):
        check_test_case(alone, LISTING)
    flown = Scenario(mission=builtin_mission("mission2"))
    dog = TestCase(target=Target(name="px4", settings={"companion": "dog"}), scenario=flown)
    with pytest.raises(Refused, match="one of none, planner, pilot"):
        check_test_case(dog, LISTING)


def test_an_item_at_no_place_is_sent_as_one() -> None:
    somewhere, nowhere = (0.0, 0.0, 0.0, 0.0, 47.4, 8.5, 20.0), (1.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    here = (0.0, 0.0, 0.0, 0.0, None, None, 0.0)
    commands = {
        22: somewhere,
        16: somewhere,
        178: nowhere,
        177: nowhere,
        112: nowhere,
        93: nowhere,
        195: somewhere,
        21: here,
        20: here,
    }
    items = tuple(MissionItem(command=command, params=params) for command, params in commands.items())
    sent = as_taken(Mission(name="m", home_lat_deg=47.4, home_lon_deg=8.5, home_alt_m=0.0, items=items))
    framed = {item.command: item.frame for item in sent.items if item.frame != 3}
    assert framed == {178: 2, 177: 2, 112: 2, 93: 2, 20: 2}
    assert [item.params for item in sent.items if item.command != 177] == [
        item.params for item in items if item.command != 177
    ]


def test_a_jump_is_counted_from_the_first_item_as_0() -> None:
    """Plans count from 1; QGroundControl takes one off for an autopilot that holds no home, and so do we."""
    jump = MissionItem(command=177, params=(2.0, 3.0, *[0.0] * 5))
    there = MissionItem(command=16, params=(*[0.0] * 4, 47.5, 8.6, 10.0))
    mission = Mission(name="m", home_lat_deg=47.4, home_lon_deg=8.5, home_alt_m=0.0, items=(there, there, jump))
    assert as_taken(mission).items[2].params[:2] == (1.0, 3.0)
    assert as_taken(mission).items[:2] == mission.items[:2]


def test_an_item_without_a_place_is_sent_to_that_of_the_one_before() -> None:
    def at(command: int, lat_deg: float, lon_deg: float, up_m: float) -> MissionItem:
        return MissionItem(command=command, params=(0.0, 0.0, 0.0, 0.0, lat_deg, lon_deg, up_m))

    items = (at(22, 0, 0, 10), at(16, 47.5, 8.6, 10), at(178, 0, 0, 0), at(16, 0, 0, 15), at(21, 0, 0, 0))
    mission = Mission(name="m", home_lat_deg=47.4, home_lon_deg=8.5, home_alt_m=0.0, items=items)
    sent = [item.params[4:] for item in as_taken(mission).items]
    assert sent == [(47.4, 8.5, 10), (47.5, 8.6, 10), (0, 0, 0), (47.5, 8.6, 15), (47.5, 8.6, 0)]
