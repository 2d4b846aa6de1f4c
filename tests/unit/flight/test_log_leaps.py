"""A leap of the estimate in a log is no move of the vehicle: resets that PX4 counts, lane switches of ArduPilot."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from log_bytes import ATTITUDE, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.flight.logs.ulog import read_ulog

LEAPS_S = 25.0
SETTINGS = {"EK3_SRC1_POSZ": 1.0, "FENCE_ENABLE": 0.0, "FENCE_TYPE": 7.0, "FENCE_ALT_MAX": 100.0, "ANGLE_MAX": 3000.0}
SETTINGS |= {"CHUTE_ENABLED": 0.0, "RTL_ALT": 1500.0, "WPNAV_ACCEL": 250.0, "PILOT_TKOFF_ALT": 0.0}
PX4_SETTINGS = {"MPC_TILTMAX_AIR": 45.0, "MPC_MAN_TILT_MAX": 35.0, "MPC_ACC_HOR": 3.0, "CBRK_FLIGHTTERM": 121212.0}


def outcome(path: Path, policy: str) -> str:
    (verdict,) = judge_file(path, None, (policy,)).verdicts
    return verdict.message if verdict.outcome == "inconclusive" else verdict.outcome


BESIDE = {
    "vehicle_status": STATUS,
    "vehicle_land_detected": [("?", "landed")],
    "vehicle_gps_position": [("B", "fix_type")],
    "manual_control_setpoint": [("?", "valid"), *(("f", name) for name in ("roll", "pitch", "yaw", "throttle"))],
    "failsafe_flags": [("?", "local_position_invalid")],
}


def px4(tmp_path: Path, leap_m: float, counter: str = "xy_reset_counter", drift_mps: float = 0.0) -> Path:
    """Position mode for 40 s from 1 s on, 10 m up; at 25 s the estimate leaps and a counter counts on."""
    topics = {
        "vehicle_local_position": [*POSITION, ("B", counter)],
        "vehicle_attitude": ATTITUDE,
        **BESIDE,
    }
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(10, 410):
        at_s, leapt = tenth / 10, tenth / 10 >= LEAPS_S
        north_m = leap_m * leapt + drift_mps * at_s
        place = (north_m, 0.0, -10.0 if tenth > 30 else 0.0, drift_mps, 0.0, 0.0, True, int(leapt))
        rows += [("vehicle_local_position", at_s, place), ("vehicle_attitude", at_s, (1.0, 0.0, 0.0, 0.0))]
        rows += [("vehicle_gps_position", at_s, (3,)), ("manual_control_setpoint", at_s, (True, 0, 0, 0, 0))]
        rows += [("failsafe_flags", at_s, (False,)), ("vehicle_land_detected", at_s, (tenth < 30,))]
        rows += [("vehicle_status", at_s, (2, 2 if tenth > 20 else 1))]
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, rows, PX4_SETTINGS))
    return path


@pytest.mark.parametrize(
    ("leap_m", "counter", "drift_mps", "expected"),
    [
        (0.0, "xy_reset_counter", 0.0, "held"),
        (4.0, "xy_reset_counter", 0.0, "held"),
        (30.0, "xy_reset_counter", 0.0, "held"),
        (4.0, "xy_valid_since", 0.0, "held"),  # an old release counts none: no speed leads there
        (4.0, "xy_reset_counter", 0.4, "violated"),
        (0.0, "xy_reset_counter", 0.4, "violated"),
    ],
)
def test_a_reset_that_a_px4_log_counts_is_no_drift(
    leap_m: float, counter: str, drift_mps: float, expected: str, tmp_path: Path
) -> None:
    assert outcome(px4(tmp_path, leap_m, counter, drift_mps), "px-position1") == expected


Told = list[tuple[str, float]]


def resets(tmp_path: Path, told: Told, drift_mps: float = 1.0, leap_m: float = 0.0) -> Path:
    """Position mode for 90 s, 10 m up: it drifts; each 4 s it leaps, and counters count on.

    What is `told` are counters and by how much a reset changed what: fields of the attitude that are called for
    quaternions, else of the local position.
    """
    turned = [one for one in told if "q" in one[0]]
    placed = [one for one in told if one not in turned]
    codes = {name: "B" if name.endswith("counter") else "f" for name, _ in told}
    topics = {
        "vehicle_local_position": [*POSITION, *((codes[name], name) for name, _ in placed)],
        "vehicle_attitude": [*ATTITUDE, *((codes[name], name) for name, _ in turned)],
        **BESIDE,
    }
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(10, 910):
        at_s, times = tenth / 10, tenth // 40
        more = {name: size if codes[name] == "f" else times % 256 for name, size in told}
        place = (drift_mps * at_s + leap_m * times, 0.0, -10.0 if tenth > 30 else 0.0, drift_mps, 0.0, 0.0, True)
        rows += [("vehicle_local_position", at_s, (*place, *(more[name] for name, _ in placed)))]
        rows += [("vehicle_attitude", at_s, (1.0, 0.0, 0.0, 0.0, *(more[name] for name, _ in turned)))]
        rows += [("vehicle_gps_position", at_s, (3,)), ("manual_control_setpoint", at_s, (True, 0, 0, 0, 0))]
        rows += [("failsafe_flags", at_s, (False,)), ("vehicle_land_detected", at_s, (tenth < 30,))]
        rows += [("vehicle_status", at_s, (2, 2 if tenth > 20 else 1))]
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, rows, PX4_SETTINGS))
    return path


def turned(by_rad: float) -> Told:
    parts = (-math.cos(by_rad / 2), 0.0, 0.0, -math.sin(by_rad / 2))
    return [(f"delta_q_reset[{part}]", value) for part, value in enumerate(parts)]


SMALL: list[Told] = [
    [("vxy_reset_counter", 0)],
    [("vxy_reset_counter", 0), ("delta_vxy[0]", 2.0), ("delta_vxy[1]", 0.0)],
    [("xy_reset_counter", 0)],
    [("xy_reset_counter", 0), ("delta_xy[0]", 0.01), ("delta_xy[1]", -0.02)],
    [("heading_reset_counter", 0)],
    [("heading_reset_counter", 0), ("delta_heading", 0.01)],
]


@pytest.mark.parametrize("told", SMALL, ids=lambda told: ",".join(name for name, _ in told))
def test_resets_that_change_no_place_hide_no_drift(told: Told, tmp_path: Path) -> None:
    assert outcome(resets(tmp_path, told), "px-position1") == "violated"


@pytest.mark.parametrize("sizes", [[], [("delta_xy[0]", 0.9), ("delta_xy[1]", 0.0)]], ids=["seen", "told"])
def test_resets_that_change_the_place_are_no_drift(sizes: Told, tmp_path: Path) -> None:
    path = resets(tmp_path, [("xy_reset_counter", 0), *sizes], 0.0, 0.9)
    assert outcome(path, "px-position1") != "violated"


@pytest.mark.parametrize(
    ("told", "flag", "leaps"),
    [
        ([("z_reset_counter", 0)], "baro_settled", False),
        ([("z_reset_counter", 0), ("delta_z", 0.1)], "baro_settled", False),
        ([("z_reset_counter", 0), ("delta_z", -0.9)], "baro_settled", True),
        ([("vz_reset_counter", 0)], "baro_settled", False),
        ([("heading_reset_counter", 0), ("delta_heading", -0.2)], "body_true", True),
        ([("heading_reset_counter", 0), ("delta_heading", 0.02)], "body_true", False),
        ([("xy_reset_counter", 0), ("delta_xy[0]", 0.25), ("delta_xy[1]", 0.25)], "gps_settled", True),
        ([("quat_reset_counter", 0)], "body_true", False),
        ([("quat_reset_counter", 0), *turned(0.1)], "body_true", True),
        ([("quat_reset_counter", 0), *turned(0.02)], "body_true", False),
    ],
)
def test_a_reset_is_a_leap_by_its_size(told: Told, flag: str, leaps: bool, tmp_path: Path) -> None:
    trace = read_ulog(resets(tmp_path, told))
    assert (flag in trace.signals and 0.0 in trace.array(flag)[100:]) is leaps


def ardupilot(tmp_path: Path, place: dict[str, float], drift_mps: float = 0.0, told: tuple[str, ...] = ()) -> Path:
    """LOITER for 40 s from 1 s on, 10 m up; at 25 s the estimate leaps by `place`, and what is `told` comes with it."""
    kinds = {
        "XKF1": ("QBffffff", "TimeUS,C,PN,PE,PD,VN,VE,VD"),
        "XKF4": ("QBffB", "TimeUS,C,OFN,OFE,PI"),
        "MODE": ("QBBB", "TimeUS,Mode,ModeNum,Rsn"),
        "EV": ("QB", "TimeUS,Id"),
        "ERR": ("QBB", "TimeUS,Subsys,ECode"),
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "GPS": ("QBB", "TimeUS,Status,NSats"),
        "BARO": ("Qf", "TimeUS,Alt"),
        "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
        "RCIN": ("QHHHH", "TimeUS,C1,C2,C3,C4"),
    }
    rows: list[tuple[str, tuple[Any, ...]]] = [("MODE", (1_000_000, 5, 5, 1)), ("ERR", (1_000_000, 1, 0))]
    rows += [("EV", (2_000_000, 10)), ("EV", (3_000_000, 28))]
    rows += [("PARM", (1_000_000, name.encode(), value)) for name, value in SETTINGS.items()]
    if "event" in told:
        rows += [("EV", (round(LEAPS_S * 1e6), 60 if "up" in place else 62))]
    for tenth in range(10, 410):
        us, leapt = tenth * 100_000, tenth / 10 >= LEAPS_S
        north_m = place.get("north", 0.0) * leapt + drift_mps * tenth / 10
        up_m = (0.0 if tenth < 30 else 10.0) + place.get("up", 0.0) * leapt
        rows += [("XKF1", (us, 0, north_m, 0.0, -up_m, drift_mps, 0.0, 0.0))]
        if "core" in told or "alike" in told:
            apart_m = 2.5 if "core" in told else 0.0
            rows += [("XKF1", (us, 1, apart_m + drift_mps * tenth / 10, 0.0, -up_m, drift_mps, 0.0, 0.0))]
        rows += [("ATT", (us, 0.0, 0.0, 40.0 + place.get("turn", 0.0) * leapt)), ("BARO", (us, up_m))]
        rows += [("RCIN", (us, 1500, 1500, 1500, 1500)), ("GPS", (us, 3, 14))]
        if not tenth % 10:
            reset_m = place.get("north", 0.0) if leapt and "reset" in told else 0.0
            reset_m += 0.02 * (tenth // 10) * ("trembles" in told)
            core = tenth // 10 % 2 if "alike" in told else int(leapt and "core" in told)
            rows += [("XKF4", (us, 0, reset_m, 0.0, core))]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, sorted(rows, key=lambda row: row[1][0])))
    return path


@pytest.mark.parametrize(
    ("place", "drift_mps", "told", "expected"),
    [
        ({}, 0.0, (), "held"),
        ({}, 0.0, ("core",), "held"),  # the other core is 2.5 m farther north
        ({"north": 0.9}, 0.0, ("reset",), "held"),
        ({"north": 30.0}, 0.0, (), "held"),
        ({"up": 5.0}, 0.0, ("event",), "held"),
        ({"turn": 40.0}, 0.0, ("event",), "held"),
        ({"turn": 40.0}, 0.0, (), "violated"),  # nothing says that it did not turn
        ({}, 0.4, ("core",), "violated"),
        ({}, 0.4, ("trembles",), "violated"),  # a reset of centimetres each second
        ({}, 0.4, ("alike",), "violated"),  # another core each second, and both say the same
        ({"north": 4.0}, 0.4, ("reset",), "violated"),
    ],
)
def test_a_lane_switch_or_reset_that_an_ardupilot_log_tells_is_no_drift(
    place: dict[str, float], drift_mps: float, told: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    assert outcome(ardupilot(tmp_path, place, drift_mps, told), "a-loiter1") == expected


def test_a_height_that_leaps_as_the_motors_are_armed_is_no_climb(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    rows: list[tuple[str, tuple[Any, ...]]] = [("EV", (at_s * 10**6, number)) for at_s, number in ((1, 18), (2, 10))]
    rows += [("EV", (9_000_000, 28))]
    rows += [("PARM", (1_000_000, name.encode(), value)) for name, value in SETTINGS.items()]
    rows += [
        ("XKF1", (tenth * 100_000, 0, 0.0, 0.0, 4.0 if tenth < 22 else 0.0, 0.0, 0.0, 0.0)) for tenth in range(10, 100)
    ]
    kinds = {
        "XKF1": ("QBffffff", "TimeUS,C,PN,PE,PD,VN,VE,VD"),
        "EV": ("QB", "TimeUS,Id"),
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "ERR": ("QBB", "TimeUS,Subsys,ECode"),
    }
    path.write_bytes(dataflash(kinds, sorted(rows, key=lambda row: row[1][0])))
    assert outcome(path, "landed-on-ground") == "held"
