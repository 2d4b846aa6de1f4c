"""Of several receivers, batteries and sources of the position a log is judged by those in use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from log_bytes import KINDS, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.contract.verdict import Verdict
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.ulog import read_ulog_log

PX4_ALONE = {"EKF2_GPS_CTRL": 7.0, "EKF2_OF_CTRL": 0.0, "EKF2_EV_CTRL": 0.0}
VISION = 1 << 12
LOST_S = 15.0
Row = tuple[str, tuple[Any, ...]]


def verdict(path: Path, policy: str) -> Verdict:
    (found,) = judge_file(path, None, (policy,)).verdicts
    return found


def px4(
    tmp_path: Path,
    settings: dict[str, float],
    fixes: dict[str, tuple[int, int]],
    status: tuple[str, str, str, float, float] | None = None,
) -> Path:
    """Position mode for 50 s from 1 s on; by receiver its fix before and after 15 s, by status topic a value each."""
    topics = {
        "vehicle_local_position": POSITION,
        "vehicle_status": STATUS,
        "vehicle_land_detected": [("?", "landed")],
        "failsafe_flags": [("?", "local_position_invalid")],
        **{name: [("B", "fix_type"), ("B", "satellites_used")] for name in fixes},
    }
    if status:
        topics[status[0]] = [(status[1], status[2])]
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(10, 510):
        at_s, later = tenth / 10, tenth / 10 >= LOST_S
        rows += [("vehicle_local_position", at_s, (0.0, 0.0, -10.0 * (tenth > 30), 0.0, 0.0, 0.0, True))]
        rows += [("vehicle_status", at_s, (2, 2 if tenth > 20 else 1)), ("failsafe_flags", at_s, (False,))]
        rows += [("vehicle_land_detected", at_s, (tenth < 30,))]
        rows += [(name, at_s, (fix[later], 14 if fix[later] >= 3 else 0)) for name, fix in fixes.items()]
        if status:
            rows += [(status[0], at_s, (status[4] if later else status[3],))]
    path = tmp_path / "flight.ulg"
    usual = {"COM_POSCTL_NAVL": 0.0, "COM_POS_FS_DELAY": 1.0, "COM_ARM_WO_GPS": 0.0}
    path.write_bytes(ulog(topics, rows, {**usual, **settings}))
    return path


def test_satellites_that_are_lost_alone_have_to_raise_the_failsafe_of_a_px4(tmp_path: Path) -> None:
    path = px4(tmp_path, PX4_ALONE, {"sensor_gps": (3, 0)})
    assert verdict(path, "px-gps-fs1").outcome == "violated"
    path = px4(tmp_path, PX4_ALONE, {"sensor_gps": (0, 0)})
    assert verdict(path, "arming-needs-position").outcome == "violated"


@pytest.mark.parametrize(
    ("settings", "status", "expected"),
    [
        ({"EKF2_GPS_CTRL": 0.0, "EKF2_EV_CTRL": 15.0}, None, "vacuous"),
        ({"EKF2_AID_MASK": 24.0}, None, "vacuous"),  # vision, up to 1.13
        ({"EKF2_AID_MASK": 1.0}, None, "violated"),
        ({"EKF2_AID_MASK": 3.0}, None, "inconclusive"),  # optical flow may go on
        ({"EKF2_GPS_CTRL": 7.0, "EKF2_OF_CTRL": 1.0, "EKF2_EV_CTRL": 0.0}, None, "inconclusive"),
        ({}, None, "inconclusive"),
        ({}, ("estimator_status_flags", "?", "cs_opt_flow", 1.0, 1.0), "vacuous"),
        ({"EKF2_GPS_CTRL": 0.0}, ("estimator_status_flags", "?", "cs_ev_pos", 0.0, 0.0), "violated"),
        ({}, ("estimator_status", "d", "control_mode_flags", VISION + 5.0, VISION + 1.0), "vacuous"),
        ({}, ("estimator_status", "d", "control_mode_flags", VISION + 5.0, 1.0), "violated"),  # vision lost, too
    ],
)
def test_satellites_that_a_px4_does_not_fly_by_need_not_be_there(
    settings: dict[str, float],
    status: tuple[str, str, str, float, float] | None,
    expected: str,
    tmp_path: Path,
) -> None:
    found = verdict(px4(tmp_path, settings, {"sensor_gps": (3, 0)}, status), "px-gps-fs1")
    assert found.outcome == expected
    assert found.outcome != "inconclusive" or "EKF2_GPS_CTRL or EKF2_AID_MASK" in found.message


@pytest.mark.parametrize(
    ("fixes", "expected"),
    [
        ({"sensor_gps": (0, 0), "sensor_gps#1": (3, 3)}, "vacuous"),
        ({"sensor_gps": (3, 0), "sensor_gps#1": (0, 3)}, "vacuous"),
        ({"sensor_gps": (3, 0), "sensor_gps#1": (3, 0)}, "violated"),
        ({"vehicle_gps_position": (3, 0), "sensor_gps": (3, 3)}, "violated"),  # what the estimator is given
    ],
)
def test_of_two_receivers_of_a_px4_the_one_with_the_better_fix_is_judged(
    fixes: dict[str, tuple[int, int]], expected: str, tmp_path: Path
) -> None:
    path = px4(tmp_path, PX4_ALONE, fixes)
    assert verdict(path, "px-gps-fs1").outcome == expected
    assert read_ulog_log(path).trace.array("gps_satellites")[600] == (14.0 if expected == "vacuous" else 0.0)


def ardupilot(
    tmp_path: Path,
    settings: dict[str, float],
    *told: Row,
    fixes: tuple[int, ...] = (3,),
    volts: dict[int, float] | None = None,
) -> Path:
    """LOITER for 60 s from 1 s on; each receiver's fix, and the voltage of each monitor from 10 s on."""
    kinds = {
        **KINDS,
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "GPS": ("QBBB", "TimeUS,I,Status,NSats"),
        "BAT": ("QBff", "TimeUS,Inst,Volt,VoltR"),
        "CTUN": ("Qf", "TimeUS,ThO"),
    }
    rows: list[Row] = [("MODE", (1_000_000, 5, 5, 1)), ("EV", (2_000_000, 10)), ("EV", (3_000_000, 28)), *told]
    rows += [("ERR", (1_000_000, 1, 0)), ("CTUN", (1_000_000, 0.3)), ("CTUN", (60_000_000, 0.3))]
    rows += [("PARM", (1_000_000, name.encode(), value)) for name, value in settings.items()]
    for tenth in range(10, 610):
        rows += [("XKF1", (tenth * 100_000, 0, 0.0, 0.0, -10.0 * (tenth > 30), 0.0, 0.0, 0.0))]
        rows += [("GPS", (tenth * 100_000, number, fix, 4 * fix)) for number, fix in enumerate(fixes)]
        for number, volt in (volts or {}).items():
            volt = volt if tenth > 100 else 16.0
            rows += [("BAT", (tenth * 100_000, number, volt, volt + 1.0))]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, sorted(rows, key=lambda row: row[1][0])))
    return path


EKF = {"FS_EKF_ACTION": 1.0, "ARMING_CHECK": 1.0}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"EK3_SRC1_POSXY": 3.0, "EK3_SRC1_VELXY": 3.0}, "violated"),
        ({"EK3_SRC1_POSXY": 6.0, "EK3_SRC1_VELXY": 6.0}, "vacuous"),
        ({"EK3_SRC1_POSXY": 0.0, "EK3_SRC1_VELXY": 5.0}, "vacuous"),
        ({"EK3_SRC1_POSXY": 3.0, "EK3_SRC1_VELXY": 5.0}, "vacuous"),
        ({"EK3_GPS_TYPE": 0.0, "FLOW_TYPE": 0.0}, "violated"),  # 4.0
        ({"EK2_GPS_TYPE": 3.0}, "vacuous"),
        ({"EK2_GPS_TYPE": 0.0, "VISO_TYPE": 1.0}, "vacuous"),
        ({}, "inconclusive"),
    ],
)
def test_satellites_that_an_ardupilot_does_not_fly_by_need_not_be_there(
    settings: dict[str, float], expected: str, tmp_path: Path
) -> None:
    path = ardupilot(tmp_path, {**EKF, **settings}, fixes=(0,))
    assert {verdict(path, name).outcome for name in ("a-gps-fs1", "arming-needs-position")} == {expected}


def test_the_set_of_sources_that_was_switched_to_last_counts(tmp_path: Path) -> None:
    settings = {"EK3_SRC1_POSXY": 3.0, "EK3_SRC1_POSZ": 1.0, "EK3_SRC2_POSXY": 6.0, "EK3_SRC2_POSZ": 2.0}
    switched: list[Row] = [("EV", (20_000_000, 86)), ("EV", (40_000_000, 85))]
    trace = read_dataflash_log(ardupilot(tmp_path, settings, *switched)).trace
    places = (180, 580, 980)
    assert [trace.array("position_aided")[place] for place in places] == [0.0, 1.0, 0.0]
    assert [trace.array("altitude_source")[place] for place in places] == [0.0, 1.0, 0.0]


def test_of_two_receivers_of_an_ardupilot_whose_use_is_not_told_the_one_with_fixes_is_judged(tmp_path: Path) -> None:
    settings = {**EKF, "EK3_SRC1_POSXY": 3.0}
    assert verdict(ardupilot(tmp_path, settings, fixes=(0, 3)), "a-gps-fs1").outcome == "vacuous"
    assert verdict(ardupilot(tmp_path, settings, fixes=(0, 0)), "a-gps-fs1").outcome == "violated"


BATTERY = {"BATT_LOW_TIMER": 10.0, "BATT2_LOW_TIMER": 10.0, "BATT_LOW_VOLT": 14.0, "BATT_FS_LOW_ACT": 2.0}


@pytest.mark.parametrize(
    ("settings", "volts", "expected"),
    [
        ({"BATT2_LOW_VOLT": 10.5}, {1: 11.5}, "vacuous"),
        ({"BATT2_LOW_VOLT": 12.5}, {1: 11.5}, "violated"),
        ({}, {1: 11.5}, "inconclusive"),  # BATT_LOW_VOLT is about another one
        ({"BATT2_LOW_VOLT": 10.5}, {0: 16.0, 1: 11.5}, "vacuous"),
        ({"BATT2_LOW_VOLT": 10.5}, {0: 13.5, 1: 11.5}, "violated"),
        ({"BATT_FS_VOLTSRC": 1.0}, {0: 13.5}, "vacuous"),  # 14.5 V without load
    ],
)
def test_a_battery_is_judged_by_its_own_limits(
    settings: dict[str, float], volts: dict[int, float], expected: str, tmp_path: Path
) -> None:
    assert verdict(ardupilot(tmp_path, {**BATTERY, **settings}, volts=volts), "battery-failsafe").outcome == expected


@pytest.mark.parametrize(("limit_v", "expected"), [(0.0, "violated"), (12.0, "inconclusive")])
def test_a_failsafe_that_another_monitor_may_have_raised_needs_no_cause_in_the_first(
    limit_v: float, expected: str, tmp_path: Path
) -> None:
    settings = {**BATTERY, "BATT2_LOW_VOLT": limit_v, "BATT2_MONITOR": 4.0, "BATT_CRT_VOLT": 0.0, "FS_OPTIONS": 0.0}
    raised: Row = ("ERR", (30_000_000, 6, 1))
    path = ardupilot(tmp_path, settings, raised, volts={0: 16.0, 1: 11.5})
    found = verdict(path, "battery-failsafe-action")
    assert found.outcome == expected, found.message


@pytest.mark.parametrize(
    ("setting", "expected"), [({}, 0.0), ({"BARO_PRIMARY": 1.0}, 5.0), ({"GND_PRIMARY": 2.0}, 0.0)]
)
def test_the_primary_barometer_is_read(setting: dict[str, float], expected: float, tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    kinds = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value"), "BARO": ("QBf", "TimeUS,I,Alt")}
    rows: list[Row] = [("PARM", (1_000_000, name.encode(), value)) for name, value in setting.items()]
    for tenth in range(10, 100):
        rows += [("XKF1", (tenth * 100_000, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))]
        rows += [("BARO", (tenth * 100_000, 0, 0.0)), ("BARO", (tenth * 100_000, 1, 0.5 * (tenth - 10)))]
    path.write_bytes(dataflash(kinds, rows))
    assert read_dataflash_log(path).trace.array("baro_altitude_m")[20] == expected


@pytest.mark.parametrize(("compass", "expected"), [(1.2, "held"), (0.2, "violated")])
def test_a_filter_that_distrusts_its_compass_has_a_cause_for_its_failsafe(
    compass: float, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "flight.bin"
    kinds = {
        **KINDS,
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "GPS": ("QBB", "TimeUS,Status,NSats"),
        "XKF4": ("QBfff", "TimeUS,C,SV,SP,SM"),
        "BAT": ("Qf", "TimeUS,Volt"),
        "RCIN": ("QHHHH", "TimeUS,C1,C2,C3,C4"),
        "ORGN": ("QBddf", "TimeUS,Type,Lat,Lng,Alt"),
    }
    settings = {**BATTERY, "BATT_CRT_VOLT": 0.0, "BATT_LOW_MAH": 0.0, "BATT_CAPACITY": 3300.0, "FS_THR_VALUE": 975.0}
    settings |= {"FENCE_ENABLE": 0.0, "FENCE_TYPE": 7.0, "FENCE_ALT_MAX": 100.0, "FENCE_RADIUS": 300.0}
    settings |= {"CHUTE_ENABLED": 0.0, "ANGLE_MAX": 3000.0, "EK3_SRC1_POSXY": 3.0}
    rows: list[Row] = [("EV", (1_000_000, 10)), ("EV", (1_500_000, 28)), ("ERR", (30_000_000, 17, 1))]
    rows += [("PARM", (1_000_000, name.encode(), value)) for name, value in settings.items()]
    rows += [("ORGN", (1_000_000, number, 47.0, 8.0, 500.0)) for number in (0, 1)]
    for tenth in range(10, 400):
        us, off = tenth * 100_000, compass if 280 <= tenth < 320 else 0.1
        rows += [("XKF1", (us, 0, 0.0, 0.0, -10.0 * (tenth > 15), 0.0, 0.0, 0.0)), ("XKF4", (us, 0, 0.1, 0.1, off))]
        rows += [("GPS", (us, 3, 14)), ("BAT", (us, 16.0)), ("RCIN", (us, 1500, 1500, 1500, 1500))]
    path.write_bytes(dataflash(kinds, sorted(rows, key=lambda row: row[1][0])))
    found = verdict(path, "failsafe-has-cause")
    assert found.outcome == expected, found.message
