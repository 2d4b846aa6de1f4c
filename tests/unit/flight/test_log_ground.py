"""Logs tell no terrain: what stood where it landed did not stop its motors in the air, wherever it took off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.contract.verdict import Verdict
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.ground import above_ground

RULES = ("armed-in-flight", "landed-on-ground")
Course = list[tuple[float, float]]


def height_at(height: Course, at_s: float) -> float:
    times, values = np.array(height).T
    return float(np.interp(at_s, times, values))


def outcomes(path: Path) -> dict[str, str]:
    return {one.policy: one.outcome if one.outcome != "inconclusive" else one.message for one in verdicts(path)}


def verdicts(path: Path) -> tuple[Verdict, ...]:
    return judge_file(path, None, RULES).verdicts


def ardupilot(tmp_path: Path, height: Course, events: list[tuple[float, int]], end_s: float = 40.0) -> Path:
    """A log from 1 s on with a height over time, and events: 10 armed, 28 off the ground, 18 landed, 11 disarmed."""
    rows: list[tuple[str, tuple[Any, ...]]] = []
    for tenth in range(10, round(end_s * 10)):
        up_m = height_at(height, tenth / 10)
        rows.append(("XKF1", (tenth * 100_000, 0, 0.0, 0.0, -up_m, 0.0, 0.0, 0.0)))
    rows += [("EV", (round(at_s * 1e6), number)) for at_s, number in events]
    rows += [("PARM", (1_000_000, name, value)) for name, value in ((b"CHUTE_ENABLED", 0.0), (b"ANGLE_MAX", 3000.0))]
    rows += [("MODE", (1_000_000, 5, 5, 1)), ("ERR", (1_000_000, 1, 0))]
    path = tmp_path / "flight.bin"
    kinds = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value")}
    path.write_bytes(dataflash(kinds, sorted(rows, key=lambda row: row[1][0])))
    return path


def px4(tmp_path: Path, height: Course, landed: Course, armed: Course, end_s: float = 40.0) -> Path:
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(10, round(end_s * 10)):
        up_m = height_at(height, tenth / 10)
        rows.append(("vehicle_local_position", tenth / 10, (0.0, 0.0, -up_m, 0.0, 0.0, 0.0, True)))
    rows += [("vehicle_land_detected", at_s, (value,)) for at_s, value in landed]
    rows += [("vehicle_status", at_s, (2, 1 + value)) for at_s, value in armed]
    rows += [("actuator_armed", at_s, (value, False)) for at_s, value in armed]
    topics = {
        "vehicle_local_position": POSITION,
        "vehicle_status": STATUS,
        "vehicle_land_detected": [("?", "landed")],
        "actuator_armed": [("?", "armed"), ("?", "kill")],
    }
    path = tmp_path / "flight.ulg"
    settings = {"CBRK_FLIGHTTERM": 121212.0, "MPC_TILTMAX_AIR": 45.0, "MPC_MAN_TILT_MAX": 35.0}
    path.write_bytes(ulog(topics, sorted(rows, key=lambda row: row[1]), settings))
    return path


UP: Course = [(5.0, 0.0), (10.0, 10.0)]
TAKES_OFF = [(3.0, 10), (5.0, 28)]


@pytest.mark.parametrize("ground_m", [-20.0, -3.0, 0.8, 3.0, 30.0])
def test_a_landing_away_from_the_height_of_the_take_off_is_a_landing(ground_m: float, tmp_path: Path) -> None:
    down: Course = [*UP, (15.0, 40.0), (30.0, ground_m)]
    path = ardupilot(tmp_path, down, [*TAKES_OFF, (31.0, 18), (32.0, 11)])
    assert outcomes(path) == {"armed-in-flight": "held", "landed-on-ground": "held"}
    path = px4(tmp_path, down, [(1, 1), (5, 0), (31, 1)], [(1, 0), (3, 1), (33, 0)])
    assert outcomes(path) == {"armed-in-flight": "held", "landed-on-ground": "held"}


@pytest.mark.parametrize("end_s", [33.2, 40.0])
def test_a_log_that_ends_with_the_disarm_says_that_it_stood(end_s: float, tmp_path: Path) -> None:
    path = ardupilot(tmp_path, [*UP, (15.0, 40.0), (30.0, 30.0)], [*TAKES_OFF, (31.0, 18), (33.0, 11)], end_s)
    assert outcomes(path)["armed-in-flight"] == "held"


def test_a_second_flight_counts_from_where_it_takes_off(tmp_path: Path) -> None:
    twice: Course = [*UP, (12.0, 30.0), (14.0, 30.0), (24.0, 30.0), (26.0, 34.0), (30.0, 34.0), (31.0, 30.0)]
    events = [*TAKES_OFF, (15.0, 18), (16.0, 11), (20.0, 10), (24.0, 28), (30.0, 11)]
    (told,) = (one for one in verdicts(ardupilot(tmp_path, twice, events)) if one.policy == "armed-in-flight")
    assert told.outcome == "violated"
    assert told.robustness == pytest.approx(-3.5, abs=0.6)


def test_motors_that_stop_in_the_air_show_by_the_fall(tmp_path: Path) -> None:
    falls: Course = [*UP, (20.0, 10.0), (21.5, 0.0)]
    assert outcomes(ardupilot(tmp_path, falls, [*TAKES_OFF, (20.0, 11)]))["armed-in-flight"] == "violated"
    path = px4(tmp_path, falls, [(1, 1), (5, 0)], [(1, 0), (3, 1), (20, 0)])
    assert outcomes(path)["armed-in-flight"] == "violated"


def test_motors_that_stop_in_the_air_as_the_log_ends_show_by_the_height(tmp_path: Path) -> None:
    path = ardupilot(tmp_path, [*UP, (20.0, 10.0), (20.4, 9.2)], [*TAKES_OFF, (20.0, 11)], end_s=20.5)
    assert outcomes(path)["armed-in-flight"] == "violated"


def test_what_takes_itself_to_stand_in_the_air_and_then_falls_did_not_stand(tmp_path: Path) -> None:
    falls: Course = [*UP, (24.0, 10.0), (25.5, 0.0)]
    told = outcomes(ardupilot(tmp_path, falls, [*TAKES_OFF, (20.0, 18), (24.0, 11)]))
    assert told == {"armed-in-flight": "violated", "landed-on-ground": "violated"}


def test_what_takes_itself_to_stand_and_climbs_or_sinks_does_not_stand(tmp_path: Path) -> None:
    climbs = ardupilot(tmp_path, [(5.0, 0.0), (30.0, 30.0)], [(3.0, 10), (4.0, 28), (4.5, 18)])
    assert outcomes(climbs)["landed-on-ground"] == "violated"
    sinks = ardupilot(tmp_path, [*UP, (12.0, 40.0), (20.0, 40.0), (39.0, 20.0)], [*TAKES_OFF, (20.0, 18)])
    assert outcomes(sinks)["landed-on-ground"] == "violated"


def test_who_carries_it_away_moves_no_ground() -> None:
    times = np.arange(0.0, 60.0, 0.1)
    height = np.interp(times, [0, 5, 10, 20, 40, 45], [0, 0, 10, 4, 4, 0])
    armed, landed = (times >= 3) & (times < 23), (times < 5) | (times >= 21)
    found = above_ground(height, armed.astype(float), landed.astype(float), 0.1)
    assert found[(times >= 21)].max() == 0.0
    assert [found[round(at_s * 10)] for at_s in (8.0, 15.0)] == pytest.approx([6.0, 3.0], abs=0.1)


def test_a_height_that_is_not_known_is_no_height_above_ground() -> None:
    height = np.array([0.0, np.nan, np.nan, 1.0])
    found = above_ground(height, np.array([0.0, 0.0, 1.0, 1.0]), None, 0.1)
    assert np.isnan(found).tolist() == [False, True, True, False]


HOVERS: Course = [*UP, (15.0, 20.0), (40.0, 20.0)]
SINKS: Course = [*UP, (15.0, 20.0), (20.0, 20.0), (40.0, 10.0)]


@pytest.mark.parametrize("height", [HOVERS, SINKS], ids=["hovers", "sinks"])
def test_what_counts_as_landed_over_ground_that_it_rose_from_is_in_the_air(height: Course, tmp_path: Path) -> None:
    path = ardupilot(tmp_path, height, [*TAKES_OFF, (22.0, 18)])
    assert outcomes(path)["landed-on-ground"] == "violated"
    path = px4(tmp_path, height, [(1, 1), (5, 0), (22, 1)], [(1, 0), (3, 1)])
    assert outcomes(path)["landed-on-ground"] == "violated"


@pytest.mark.parametrize("end_s", [30.5, 40.0])
def test_what_counts_as_landed_in_a_hover_and_stops_its_motors_is_in_the_air(end_s: float, tmp_path: Path) -> None:
    path = px4(tmp_path, HOVERS, [(1, 1), (5, 0), (22, 1)], [(1, 0), (3, 1), (30, 0)], end_s)
    assert outcomes(path) == {"armed-in-flight": "violated", "landed-on-ground": "violated"}


@pytest.mark.parametrize("up_m", [0.7, 1.3, 1.45, 1.7])
def test_motors_that_stop_just_above_the_ground_show_by_the_drop(up_m: float, tmp_path: Path) -> None:
    drops: Course = [*UP, (25.0, up_m), (30.0, up_m), (30.5, 0.0), (40.0, 0.0)]
    assert outcomes(ardupilot(tmp_path, drops, [*TAKES_OFF, (30.0, 11)]))["armed-in-flight"] == "violated"
    path = px4(tmp_path, drops, [(1, 1), (5, 0)], [(1, 0), (3, 1), (30, 0)])
    assert outcomes(path)["armed-in-flight"] == "violated"


def test_motors_that_stop_in_a_hover_show_where_the_estimate_stays_as_it_was(tmp_path: Path) -> None:
    assert outcomes(ardupilot(tmp_path, HOVERS, [*TAKES_OFF, (30.0, 11)]))["armed-in-flight"] == "violated"


TIMES = np.arange(0.0, 80.0, 0.1)
HOVER = np.interp(TIMES, [0, 5, 10, 50, 75, 80], [0, 0, 40, 40, 0, 0])


def above(height: Any, landed: Any, place: Any = None, throttle: Any = None) -> Any:
    """Armed from 3 s on, landed until 5 s, from 76 s on, and as given."""
    landed = (TIMES < 5) | (TIMES >= 76) | landed
    return above_ground(height, (TIMES > 3).astype(float), landed.astype(float), 0.1, place, throttle)


def test_a_moment_of_landed_in_a_hover_moves_no_ground() -> None:
    found = above(HOVER, (TIMES >= 20) & (TIMES < 20.2))
    assert found == pytest.approx(HOVER)


def test_some_time_of_landed_in_a_hover_is_in_the_air_where_it_was_lower_nearby_and_not_known_elsewhere() -> None:
    landed = (TIMES >= 20) & (TIMES < 30)
    home = np.zeros((len(TIMES), 2))
    assert above(HOVER, landed, home) == pytest.approx(HOVER)
    away = np.interp(TIMES, [10, 12, 40, 45], [0, 100, 100, 0])[:, None] * [0.0, 1.0]
    for place in (away, None):
        found = above(HOVER, landed, place)
        assert np.isnan(found).tolist() == landed.tolist()
        assert found[~landed] == pytest.approx(HOVER[~landed])


def test_a_hill_that_it_descends_to_and_rises_from_is_ground_and_what_it_later_sinks_below_is_not() -> None:
    height = np.interp(TIMES, [0, 5, 10, 12, 20, 33, 40, 50, 75, 80], [0, 0, 40, 40, 30, 30, 40, 40, 0, 0])
    landed = (TIMES >= 21) & (TIMES < 33)
    hill = np.interp(TIMES, [10, 12, 40, 45], [0, 100, 100, 0])[:, None] * [0.0, 1.0]
    assert above(height, landed, hill)[landed] == pytest.approx(0.0)
    assert np.isnan(above(height, landed, np.zeros((len(TIMES), 2)))[landed]).all()
    assert np.isnan(above(height, landed, hill + 2.0 * np.maximum(0.0, TIMES - 20)[:, None])[landed]).all()
    carried = np.full(len(TIMES), 0.4)
    assert np.isnan(above(height, landed, hill, carried)[landed]).all()
    assert above(height, landed, hill, np.where(landed, 0.1, 0.4))[landed] == pytest.approx(0.0)


def test_motors_that_stop_for_a_moment_in_the_air_move_no_ground() -> None:
    armed = (TIMES > 3) & ~((TIMES >= 30) & (TIMES < 30.2))
    landed = (TIMES < 5) | (TIMES >= 76)
    found = above_ground(HOVER, armed.astype(float), landed.astype(float), 0.1)
    assert found == pytest.approx(HOVER)


def test_a_roof_that_nobody_says_it_stands_on_gives_no_alarm(tmp_path: Path) -> None:
    """It descends to 10 m and its log ends as the motors stop, or a while later; it never counts as landed."""
    roof: Course = [*UP, (15.0, 20.0), (28.0, 10.0), (45.0, 10.0)]
    path = px4(tmp_path, roof, [(1, 1), (5, 0)], [(1, 0), (3, 1), (32, 0)], end_s=32.3)
    assert outcomes(path)["armed-in-flight"].startswith("not known all the time: above_ground_m")
    path = px4(tmp_path, roof, [(1, 1), (5, 0)], [(1, 0), (3, 1), (32, 0)])
    assert outcomes(path)["armed-in-flight"] == "held"


@pytest.mark.parametrize(("fallen_m", "least_m"), [(0.0, 0.0), (8.0, 6.0)])
def test_what_the_barometer_sees_standing_still_does_not_fall_whatever_the_estimate_does(
    fallen_m: float, least_m: float
) -> None:
    at_s = np.arange(0.0, 20.0, 0.05)
    height_m = np.interp(at_s, [0.0, 5.0, 10.0], [0.0, -8.0, -8.0])
    baro_m = np.interp(at_s, [0.0, 5.0, 10.0], [0.0, -fallen_m, -fallen_m])
    armed, landed = np.ones_like(at_s), np.ones_like(at_s)
    above_m = above_ground(height_m, armed, landed, 0.05, baro_m=baro_m)
    assert np.nanmax(above_m) == pytest.approx(max(least_m, 0.0), abs=2.1)


def test_a_knock_at_the_barometer_is_no_fall() -> None:
    at_s = np.arange(0.0, 20.0, 0.05)
    height_m, baro_m = np.interp(at_s, [0.0, 5.0, 10.0], [0.0, -8.0, -8.0]), np.zeros_like(at_s)
    baro_m[200] = 3.0
    above_m = above_ground(height_m, np.ones_like(at_s), np.ones_like(at_s), 0.05, baro_m=baro_m)
    assert np.nanmax(above_m) == pytest.approx(0.0, abs=0.1)


def test_a_barometer_that_is_silent_says_nothing_of_a_fall() -> None:
    at_s = np.arange(0.0, 20.0, 0.05)
    height_m = np.interp(at_s, [0.0, 5.0], [0.0, -8.0])
    armed, landed = np.ones_like(at_s), np.ones_like(at_s)
    silent = above_ground(height_m, armed, landed, 0.05, baro_m=np.full(len(at_s), np.nan))
    np.testing.assert_array_equal(silent, above_ground(height_m, armed, landed, 0.05))
    assert np.nanmax(silent) > 5.0


@pytest.mark.parametrize(
    ("status", "off_m", "known"), [(2, -40.0, False), (2, -1.0, True), (2, 5.0, True), (1, -40.0, True)]
)
def test_where_a_landing_slows_down_is_not_known_where_terrain_data_put_the_ground_higher(
    status: int, off_m: float, known: bool, tmp_path: Path
) -> None:
    kinds = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value"), "TERR": ("QBf", "TimeUS,Status,CHeight")}
    rows: list[tuple[str, tuple[Any, ...]]] = [("PARM", (1_000_000, b"LAND_ALT_LOW", 1000.0))]
    for tenth in range(10, 200):
        rows += [("XKF1", (tenth * 100_000, 0, 0.0, 0.0, -25.0 if tenth > 12 else 0.0, 0.0, 0.0, 0.0))]
        rows += [("TERR", (tenth * 100_000, status, 25.0 + off_m))] if tenth >= 100 else []
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, rows))
    low_m = read_dataflash_log(path).trace.array("land_altitude_low_set_m")
    assert (low_m[40], bool(np.isfinite(low_m[-1]))) == (10.0, known)
