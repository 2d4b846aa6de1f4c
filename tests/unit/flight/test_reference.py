"""The reference autopilot: modes, failsafes, commands, refusals, in short flights."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord, trace_digest
from saflite.contract.signals import MODES, SIGNALS
from saflite.contract.test_case import (
    Mission,
    MissionItem,
    Obstacle,
    Scenario,
    StartState,
    Stimulus,
    StimulusKind,
    Target,
    TestCase,
    Wind,
)
from saflite.flight.autopilots.reference import tables
from saflite.flight.mission import builtin_mission, dump_plan, parse_plan
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

Input = tuple[float, StimulusKind, str, tuple[float, ...]]


STILL = Wind()


def never() -> bool:
    return False


def case(
    mode: str,
    altitude_m: float,
    time_s: float,
    inputs: Sequence[Input] = (),
    *,
    wind: Wind = STILL,
    **parameters: float,
) -> TestCase:
    return TestCase(
        target=Target(parameters=parameters),
        scenario=Scenario(start=StartState(mode=mode, altitude_m=altitude_m), time_limit_s=time_s, wind=wind),
        stimuli=tuple(Stimulus(at_s=at, kind=kind, name=name, values=values) for at, kind, name, values in inputs),
        rng_seed=3,
    )


def fly(test_case: TestCase) -> FlightRecord:
    record = fly_once(test_case)
    assert record.trace is not None
    return record


def last(record: FlightRecord, name: str) -> float:
    assert record.trace is not None
    return float(record.trace.array(name)[-1])


def texts(record: FlightRecord) -> str:
    assert record.trace is not None
    return "\n".join(message.text for message in record.trace.messages)


# ---- modes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["LOITER", "GUIDED", "ALT_HOLD", "BRAKE"])
def test_holding_modes_hold_their_height_in_wind(mode: str) -> None:
    record = fly(case(mode, 30.0, 20.0, wind=Wind(mean_mps=6.0, from_deg=200.0, gust_mps=1.0)))
    assert record.trace is not None
    altitude = record.trace.array("altitude_m")
    assert np.abs(altitude - 30.0).max() < 1.2
    if mode != "ALT_HOLD":
        reach = np.hypot(record.trace.array("x_m"), record.trace.array("y_m"))
        assert reach.max() < 1.5


def test_start_state_is_settled() -> None:
    record = fly(case("LOITER", 40.0, 2.0))
    assert record.trace is not None
    assert abs(float(record.trace.array("climb_mps")[0])) < 0.15
    assert float(record.trace.array("mode")[0]) == MODES["LOITER"]


def test_guided_takes_off_and_goes_to_a_place() -> None:
    inputs: list[Input] = [
        (1.0, "command", "MAV_CMD_NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, 8.0)),
        (12.0, "command", "MAV_CMD_DO_REPOSITION", (0, 0, 0, 0, 47.3978419, 8.5455938, 12.0)),
    ]
    record = fly(case("GUIDED", 0.0, 30.0, inputs))
    assert last(record, "x_m") == pytest.approx(11.12, abs=0.8)
    assert last(record, "altitude_m") == pytest.approx(12.0, abs=0.6)


def test_rtl_climbs_flies_home_lands_and_disarms() -> None:
    inputs: list[Input] = [
        (0.5, "command", "MAV_CMD_DO_REPOSITION", (0, 0, 0, 0, 47.3979219, 8.5455938, 10.0)),
        (10.0, "mode", "RTL", ()),
    ]
    record = fly(case("GUIDED", 10.0, 120.0, inputs, RTL_ALT=1500.0, RTL_LOIT_TIME=1000.0))
    assert record.trace is not None
    assert record.ending == "completed"
    assert record.trace.array("altitude_m").max() == pytest.approx(15.0, abs=0.7)
    assert last(record, "armed") == 0.0
    assert last(record, "home_distance_m") < 1.0


@pytest.mark.parametrize("mode", ["BRAKE", "LOITER", "STABILIZE"])
def test_land_ordered_on_the_ground_stops_the_motors_whatever_the_delay(mode: str) -> None:
    record = fly(case(mode, 0.0, 12.0, [(2.0, "mode", "LAND", ())], DISARM_DELAY=0.0))
    assert last(record, "mode") == MODES["LAND"]
    assert last(record, "armed") == 0.0


def test_land_slows_down_near_the_ground() -> None:
    record = fly(case("LAND", 16.0, 40.0))
    assert record.trace is not None
    altitude, climb = record.trace.array("altitude_m"), record.trace.array("climb_mps")
    assert climb[(altitude > 1.0) & (altitude < 8.0)].mean() == pytest.approx(-0.7, abs=0.1)
    assert record.ending == "completed"


def test_circle_keeps_its_radius_and_sticks_change_it() -> None:
    record = fly(case("CIRCLE", 30.0, 25.0, [(12.0, "stick", "RC2", (1200.0,))]))
    assert record.trace is not None
    x, y = record.trace.array("x_m")[250:600], record.trace.array("y_m")[250:600]
    assert np.hypot(x - 10.0, y).mean() == pytest.approx(10.0, abs=1.0)
    assert last(record, "circle_radius_m") < 5.0


def test_a_circle_is_flown_no_faster_than_its_curve_can_be_held() -> None:
    record = fly(case("LOITER", 20.0, 40.0, [(1.0, "mode", "CIRCLE", ())], WPNAV_ACCEL=100.0))
    assert record.trace is not None
    x, y = record.trace.array("x_m"), record.trace.array("y_m")
    late = slice(len(x) // 2, None)
    across = max(float(np.ptp(x[late])), float(np.ptp(y[late])))
    assert across == pytest.approx(20.0, abs=3.0)


def test_flip_turns_once_and_comes_back() -> None:
    record = fly(case("ALT_HOLD", 50.0, 12.0, [(1.0, "mode", "FLIP", ())]))
    assert record.trace is not None
    assert record.trace.array("roll_rate_dps").max() > 300.0
    assert np.abs(record.trace.array("roll_deg")).max() > 150.0
    assert last(record, "mode") == MODES["ALT_HOLD"]
    assert abs(last(record, "roll_deg")) < 3.0
    assert abs(last(record, "altitude_m") - 50.0) < 7.0


def test_acro_turns_with_the_stick() -> None:
    inputs: list[Input] = [(1.0, "stick", "RC1", (1700.0,))]
    record = fly(case("ACRO", 60.0, 2.0, inputs, ACRO_TRAINER=0.0))
    assert last(record, "roll_rate_dps") > 30.0


def test_brake_stops_quickly() -> None:
    inputs: list[Input] = [
        (0.5, "command", "MAV_CMD_DO_REPOSITION", (0, 0, 0, 0, 47.4, 8.5455938, 30.0)),
        (6.0, "mode", "BRAKE", ()),
    ]
    record = fly(case("GUIDED", 30.0, 14.0, inputs))
    assert record.trace is not None
    speed = np.hypot(record.trace.array("vx_mps"), record.trace.array("vy_mps"))
    assert speed[300] > 3.0
    assert speed[-50:].max() < 0.4


# ---- failsafes, parachute, fence ------------------------------------------------------------------------------------


def test_gps_loss_lands_after_the_delay() -> None:
    record = fly(case("LOITER", 20.0, 8.0, [(1.0, "sensor_fault", "gps_loss", (1.0,))], COM_POS_FS_DELAY=3.0))
    assert record.trace is not None
    raised_s = float(np.argmax(record.trace.array("failsafe_gps") > 0)) * record.trace.step_s
    assert raised_s == pytest.approx(4.1, abs=0.3)
    assert last(record, "mode") == MODES["LAND"]


def test_gps_jump_ends_in_a_landing_near_where_it_flew() -> None:
    record = fly(case("LOITER", 12.0, 45.0, [(2.0, "sensor_fault", "gps_offset_east", (80.0,))]))
    assert record.ending == "completed"
    assert abs(last(record, "y_m")) < 15.0


def test_radio_loss_returns_home_unless_switched_off() -> None:
    inputs: list[Input] = [(1.0, "sensor_fault", "radio_loss", (1.0,))]
    assert last(fly(case("LOITER", 20.0, 4.0, inputs)), "mode") == MODES["RTL"]
    assert last(fly(case("LOITER", 20.0, 4.0, inputs, FS_THR_ENABLE=0.0)), "mode") == MODES["LOITER"]


def test_radio_failsafe_stands_until_there_are_good_pulses_again() -> None:
    low: Input = (1.0, "stick", "RC3", (900.0,))
    silent: Input = (3.0, "sensor_fault", "radio_loss", (1.0,))
    record = fly(case("LOITER", 20.0, 6.0, [low, silent]))
    assert "cleared" not in texts(record), "no pulses at all are not better than bad ones"
    good: Input = (3.0, "stick", "RC3", (1500.0,))
    assert "Radio failsafe cleared" in texts(fly(case("LOITER", 20.0, 6.0, [low, good])))


def test_low_battery_returns_home() -> None:
    inputs: list[Input] = [(1.0, "sensor_fault", "battery_voltage", (13.0,))]
    record = fly(case("LOITER", 20.0, 10.0, inputs, BATT_LOW_VOLT=14.0))
    assert last(record, "failsafe_battery") == 1.0
    assert last(record, "mode") == MODES["RTL"]


def test_fence_stops_a_climb() -> None:
    inputs: list[Input] = [(1.0, "stick", "RC3", (2000.0,))]
    record = fly(case("ALT_HOLD", 20.0, 20.0, inputs, FENCE_ENABLE=1.0, FENCE_ALT_MAX=30.0))
    assert record.trace is not None
    assert record.trace.array("altitude_m").max() < 30.0


def test_parachute_opens_and_the_fall_is_slow() -> None:
    inputs: list[Input] = [(2.0, "command", "MAV_CMD_DO_PARACHUTE", (2.0,))]
    record = fly(case("ALT_HOLD", 50.0, 9.0, inputs, CHUTE_ENABLED=1.0))
    assert last(record, "chute_released") == 1.0
    assert last(record, "armed") == 0.0
    assert last(record, "climb_mps") == pytest.approx(-5.0, abs=1.0)


def test_engine_failure_ends_in_a_crash() -> None:
    inputs: list[Input] = [
        (1.0, "sensor_fault", "SIM_ENGINE_MUL", (0.0,)),
        (1.0, "sensor_fault", "engine_failure", (1.0,)),
    ]
    record = fly(case("LOITER", 20.0, 30.0, inputs))
    assert record.ending == "crashed"
    assert record.trace is not None
    assert all(np.isfinite(record.trace.array(name)).all() for name in record.trace.signals)


# ---- parameters, commands, refusals ---------------------------------------------------------------------------------


def test_a_parameter_acts_at_once_or_after_a_restart() -> None:
    slow = fly(case("LAND", 16.0, 14.0, [(0.1, "parameter", "LAND_SPEED", (30.0,))]))
    assert last(slow, "climb_mps") == pytest.approx(-0.3, abs=0.1)
    shown = fly(case("ALT_HOLD", 20.0, 3.0, [(0.5, "parameter", "EK2_ALT_SOURCE", (2.0,))]))
    assert last(shown, "altitude_source") == 0.0
    started = fly(case("ALT_HOLD", 20.0, 3.0, EK2_ALT_SOURCE=2.0))
    assert last(started, "altitude_source") == 2.0


def test_every_parameter_takes_its_default_and_both_ends_of_its_range() -> None:
    for row in tables.parameters().values():
        assert row.low <= row.default <= row.high, row.name
    assert len(tables.parameters()) >= 80


@pytest.mark.parametrize("name", sorted(tables.commands()))
def test_every_command_answers_with_any_numbers(name: str) -> None:
    inputs: list[Input] = [(0.2 * i, "command", name, (float(value),) * 7) for i, value in enumerate((0, 1, 2, 47, -1))]
    record = fly(case("LOITER", 30.0, 1.5, inputs))
    assert texts(record).count(f"Command {name}: ") == 5


def test_refusals_name_what_is_wrong() -> None:
    wrong: list[tuple[TestCase, str]] = [
        (case("DRIFT", 20.0, 5.0), "start mode"),
        (case("LOITER", -1.0, 5.0), "altitude_m"),
        (case("LOITER", 20.0, 0.0), "time_limit_s"),
        (case("LOITER", 20.0, 5.0, NO_SUCH=1.0), "parameter"),
        (case("LOITER", 20.0, 5.0, RTL_ALT=-1.0), "parameter RTL_ALT"),
        (case("LOITER", 20.0, 5.0, [(1.0, "stick", "RC9", (1500.0,))]), "stick"),
        (case("LOITER", 20.0, 5.0, [(1.0, "command", "NO_SUCH", ())]), "command"),
        (case("LOITER", 20.0, 5.0, [(1.0, "sensor_fault", "NO_SUCH", ())]), "sensor fault"),
        (case("LOITER", 20.0, 5.0, [(-1.0, "mode", "LAND", ())]), "stimulus time"),
        (TestCase(target=Target(settings={"defects": ["no-such"]}), scenario=Scenario()), "defect"),
    ]
    for test_case, what in wrong:
        with pytest.raises(Refused, match=what):
            fly_once(test_case)


def test_a_cancelled_flight_stops() -> None:
    with pytest.raises(Unavailable):
        fly_once(case("LOITER", 20.0, 500.0), lambda: True)


# ---- missions and determinism ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "real_s"), [("mission1", 85.0), ("mission2", 134.0), ("mission3", 147.0)])
def test_free_missions_take_as_long_as_the_real_vehicle(name: str, real_s: float) -> None:
    record = fly(TestCase(target=Target(), scenario=Scenario(mission=builtin_mission(name)), rng_seed=5))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.duration_s == pytest.approx(real_s, rel=0.1)
    speed = np.hypot(record.trace.array("vx_mps"), record.trace.array("vy_mps"))
    assert np.median(speed[speed > 1.0]) == pytest.approx(1.375, abs=0.12)


def test_a_flight_after_another_is_bit_equal_to_the_flight_alone() -> None:
    wall = Obstacle(length_m=12.0, width_m=4.0, height_m=20.0, x_m=-3.0, y_m=22.0, rotation_deg=20.0)
    scenario = Scenario(mission=builtin_mission("mission1"), obstacles=(wall,), wind=Wind(mean_mps=2.0, gust_mps=0.5))
    test_case = TestCase(target=Target(), scenario=scenario, rng_seed=9)
    alone = fly(test_case)
    fly(case("ACRO", 30.0, 3.0, [(0.5, "stick", "RC1", (1900.0,))]))
    again = fly(test_case)
    assert alone.trace is not None
    assert again.trace is not None
    assert trace_digest(alone.trace) == trace_digest(again.trace)
    other = fly(TestCase(target=Target(), scenario=scenario, rng_seed=10))
    assert other.trace is not None
    assert trace_digest(other.trace) != trace_digest(alone.trace)


def test_flying_into_a_box_ends_the_flight() -> None:
    inside = Obstacle(length_m=6.0, width_m=6.0, height_m=25.0, x_m=0.0, y_m=0.0)
    record = fly(TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission1"), obstacles=(inside,))))
    assert record.ending == "crashed"
    assert last(record, "contact") == 1.0
    assert last(record, "obstacle_distance_m") == 0.0


def test_trace_names_are_all_in_the_signal_table() -> None:
    record = fly(case("LOITER", 20.0, 1.0))
    assert record.trace is not None
    assert set(record.trace.signals) <= set(SIGNALS)
    assert len(record.trace.signals) > 50
    assert record.trace.samples == 51
    assert math.isclose(record.trace.duration_s, 1.0)


# ---- settings at the ends of their ranges ---------------------------------------------------------------------------


def test_the_least_jerk_set_does_not_make_the_vehicle_swing() -> None:
    stop: list[Input] = [
        (1.0, "stick", "RC2", (1000.0,)),
        (5.0, "stick", "RC2", (1500.0,)),
        (5.0, "mode", "GUIDED", ()),
    ]
    record = fly(case("ALT_HOLD", 30.0, 40.0, stop, PSC_JERK_XY=3.0, PSC_VELXY_P=3.4))
    assert record.trace is not None
    late = slice(int(25.0 / record.trace.step_s), None)
    speed = np.hypot(record.trace.array("vx_mps")[late], record.trace.array("vy_mps")[late])
    assert speed.max() < 0.5


def test_the_speed_loop_sums_nothing_up_while_it_leans_as_far_as_it_may() -> None:
    """Summed up, the same braking ends 7 m behind the farthest point, not 3 m."""
    brake: list[Input] = [(1.0, "stick", "RC2", (1000.0,)), (9.0, "stick", "RC2", (1500.0,)), (9.0, "mode", "LAND", ())]
    record = fly(
        case("ALT_HOLD", 30.0, 40.0, brake, ANGLE_MAX=1000.0, PSC_VELXY_I=1.2, PSC_VELXY_IMAX=1000.0, WPNAV_ACCEL=500.0)
    )
    assert record.trace is not None
    away = np.hypot(record.trace.array("x_m"), record.trace.array("y_m"))
    assert away.max() - away[away.argmax() :].min() < 4.5


def test_a_mission_begun_again_in_the_air_flies_to_its_first_way_point_again() -> None:
    """It took the way-point for passed, since the leg began where a place had last been held: at home."""
    up = MissionItem(command=22, params=(0, 0, 0, 0, HOME_LAT_DEG, HOME_LON_DEG, 8))
    first = MissionItem(command=16, params=(0, 0, 0, 0, HOME_LAT_DEG + 1e-4, HOME_LON_DEG, 8))
    second = MissionItem(command=16, params=(0, 0, 0, 0, HOME_LAT_DEG + 2e-4, HOME_LON_DEG + 2e-4, 8))
    mission = Mission(
        name="corner", home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=(up, first, second)
    )
    again = Stimulus(at_s=48.0, kind="command", name="MAV_CMD_MISSION_START")
    scenario = Scenario(mission=parse_plan(dump_plan(mission), "corner", "corner"), time_limit_s=90.0)
    trace = fly(TestCase(target=Target(), scenario=scenario, stimuli=(again,), rng_seed=3)).trace
    assert trace is not None
    far_m = np.hypot(trace.array("x_m") - 11.1, trace.array("y_m"))
    at = round(48.0 / trace.step_s)
    assert far_m[at] > 6.0, "it is on its second leg"
    assert far_m[at:].min() < 3.0


def test_a_mission_goes_on_below_a_ceiling_that_its_way_point_lies_above() -> None:
    """It hovered there for ever: in a hover the height shakes by as much as counted as coming nearer."""
    places = ((22, 0.0, 8), (16, 1e-4, 25), (16, 2e-4, 8))
    items = [
        MissionItem(command=command, params=(0, 0, 0, 0, HOME_LAT_DEG + north, HOME_LON_DEG, height))
        for command, north, height in places
    ]
    mission = Mission(
        name="high", home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=tuple(items)
    )
    scenario = Scenario(mission=parse_plan(dump_plan(mission), "high", "high"), time_limit_s=90.0)
    low = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 1.0, "FENCE_ALT_MAX": 17.0}
    trace = fly(TestCase(target=Target(parameters=low), scenario=scenario, rng_seed=3)).trace
    assert trace is not None
    assert trace.array("mission_item").max() == 2.0
    assert trace.array("altitude_m").max() < 17.0
