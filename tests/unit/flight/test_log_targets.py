"""A companion may tell by a stream of targets where to go in GUIDED and offboard: those are orders, of own speeds."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import ATTITUDE, KINDS, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.dataflash_rows import Rows
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.targets import _forget, _near, targets_of_ardupilot
from saflite.flight.logs.ulog import read_ulog_log
from saflite.oracle.orders import may_change_mode

Row = tuple[str, tuple[Any, ...]]
Kinds = dict[str, tuple[str, str]]
MORE: Kinds = {
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "GPS": ("QBIHB", "TimeUS,Status,GMS,GWk,NSats"),
    "MAVC": ("QHfffffff", "TimeUS,Cmd,P1,P2,P3,P4,X,Y,Z"),
    "GUIP": ("QBfff", "TimeUS,Type,vX,vY,vZ"),
    "GUID": ("QBfff", "TimeUS,Type,vX,vY,vZ"),
    "GUIA": ("QBf", "TimeUS,Type,Roll"),
}
GUID_OF_4_1 = ("QBffff", "TimeUS,Type,vX,vY,vZ,aX")
SETTINGS = {
    "WPNAV_SPEED": 500.0,
    "WPNAV_SPEED_UP": 250.0,
    "WPNAV_SPEED_DN": 150.0,
    "LOIT_SPEED": 1250.0,
    "RTL_SPEED": 0.0,
    "CHUTE_ENABLED": 0.0,
}
NAME = "SET_POSITION_TARGET_LOCAL_NED"


def copter(*told: Row, mode: int = 4, kinds: Kinds = MORE) -> bytes:
    """A log of 40 s from 1 s on, in GUIDED unless told otherwise: from 5 s on north at 20 m/s, 20 m up."""
    rows: list[Row] = [("PARM", (1_000_000, name.encode(), value)) for name, value in SETTINGS.items()]
    rows += [("MODE", (1_000_000, mode, mode, 1)), ("EV", (1_000_000, 10)), ("EV", (1_000_001, 28))]
    rows += [("ERR", (1_000_000, 1, 0))]
    for tenth in range(400):
        at, moved_s = 1_000_000 + tenth * 100_000, max(0.0, tenth / 10 - 5.0)
        speed = 20.0 if moved_s else 0.0
        rows += [
            ("XKF1", (at, 0, 20.0 * moved_s, 0.0, -20.0, speed, 0.0, 0.0)),
            ("GPS", (at, 3, tenth * 100, 2000, 12)),
        ]
    return dataflash({**KINDS, **kinds}, sorted([*rows, *told], key=lambda row: row[1][0]))


def stream(kind: str, number: int, since_s: float = 5.0, until_s: float = 41.0, step_s: float = 0.1) -> list[Row]:
    after = (0.0,) * (len(MORE[kind][0]) - 2)
    times = np.arange(since_s, until_s, step_s)
    return [(kind, (round(at_s * 1e6), number, *after)) for at_s in times]


def read(tmp_path: Path, data: bytes) -> FlightLog:
    path = tmp_path / "flight.bin"
    path.write_bytes(data)
    return read_dataflash_log(path)


def outcome(tmp_path: Path, data: bytes, policy: str = "speed-limit") -> str:
    path = tmp_path / "flight.bin"
    path.write_bytes(data)
    (verdict,) = judge_file(path, None, (policy,)).verdicts
    return verdict.outcome


@pytest.mark.parametrize(
    ("kind", "number", "told"),
    [
        ("GUIP", 1, "violated"),
        ("GUIP", 2, "violated"),
        ("GUIP", 3, "inconclusive"),
        ("GUIP", 4, "inconclusive"),
        ("GUIP", 5, "inconclusive"),
        ("GUID", 1, "violated"),
        ("GUID", 2, "inconclusive"),
        ("GUID", 3, "inconclusive"),
        ("GUID", 4, "inconclusive"),
        ("GUIA", 6, "inconclusive"),
    ],
)
def test_who_is_given_a_speed_or_a_lean_flies_by_it_not_by_the_speed_that_was_set(
    kind: str, number: int, told: str, tmp_path: Path
) -> None:
    assert outcome(tmp_path, copter(*stream(kind, number))) == told


@pytest.mark.parametrize(
    ("number", "north_mps", "told"),
    [(1, 0.0, "violated"), (2, 0.0, "violated"), (2, 20.0, "inconclusive"), (3, 0.0, "inconclusive")],
)
def test_what_a_target_is_of_is_numbered_anew_since_it_tells_accelerations(
    number: int, north_mps: float, told: str, tmp_path: Path
) -> None:
    """From 4.1 on 2 is a place sent as such, or one with a speed; it was a speed alone before."""
    targets: list[Row] = [("GUID", (tenth * 100_000, number, north_mps, 0.0, 0.0, 0.0)) for tenth in range(50, 410)]
    assert outcome(tmp_path, copter(*targets, kinds={**MORE, "GUID": GUID_OF_4_1})) == told


def test_the_speeds_that_were_set_count_again_with_another_target_or_mode(tmp_path: Path) -> None:
    place, mode = ("GUIP", (20_000_000, 1, 0.0, 0.0, 0.0)), ("MODE", (30_000_000, 3, 3, 1))
    told = [*stream("GUIP", 4, 5.0, 10.0), place, *stream("GUIP", 4, 25.0, 28.0), mode]
    trace = read(tmp_path, copter(*told)).trace
    for name in ("cruise_speed_set_mps", "takeoff_speed_set_mps", "descent_speed_set_mps"):
        unknown = np.isnan(trace.array(name))
        at_s = {at: bool(unknown[round((at - 1.0) / 0.05)]) for at in (4.0, 6.0, 15.0, 21.0, 26.0, 29.0, 31.0)}
        assert [at for at, is_unknown in at_s.items() if is_unknown] == [6.0, 15.0, 26.0, 29.0], name


def test_targets_are_orders_told_once_a_second_beside_the_commands(tmp_path: Path) -> None:
    given = read(tmp_path, copter(*stream("GUIP", 4))).stimuli
    assert {(one.kind, one.name) for one in given} == {("command", NAME)}
    assert [one.at_s for one in given] == pytest.approx(np.arange(4.0, 40.0, 1.0), abs=0.15)
    assert not may_change_mode(given[0])


def test_a_target_that_a_command_sets_is_no_order_of_its_own(tmp_path: Path) -> None:
    command: Row = ("MAVC", (10_000_000, 192, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    given = read(tmp_path, copter(command, ("GUIP", (10_020_000, 1, 0.0, 0.0, 0.0)))).stimuli
    assert [one.name for one in given] == ["MAV_CMD_DO_REPOSITION"]


def test_a_stream_of_hours_is_told_by_as_many_orders_as_a_test_case_holds() -> None:
    told: Rows = defaultdict(list, GUIP=[(float(at_s), {"Type": 4}) for at_s in range(14_000)])
    given = targets_of_ardupilot(told, Columns())
    assert 4_000 < len(given) <= 5_001
    assert (given[0].at_s, given[-1].at_s) == pytest.approx((0.0, 13_999.0), abs=3.0)


def offboard(state: int) -> bytes:
    """A PX4 log of 40 s from 5 s on: north at 20 m/s, 20 m up, in a state of navigation from 10 s to 30 s."""
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(400):
        at = 5 + tenth / 10
        rows.append(("vehicle_local_position", at, (2.0 * tenth, 0.0, -20.0, 20.0, 0.0, 0.0, True)))
        rows.append(("vehicle_attitude", at, (1.0, 0.0, 0.0, 0.0)))
    rows += [("vehicle_status", at, (number, 2)) for at, number in ((5.0, 4), (10.0, state), (30.0, 4))]
    topics = {"vehicle_local_position": POSITION, "vehicle_status": STATUS, "vehicle_attitude": ATTITUDE}
    return ulog(topics, rows, parameters={"MPC_XY_CRUISE": 5.0, "MPC_TKO_SPEED": 1.5, "MPC_Z_V_AUTO_DN": 1.0})


@pytest.mark.parametrize(("state", "streamed"), [(14, True), (17, False)])
def test_offboard_is_a_stream_of_targets(state: int, streamed: bool, tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(offboard(state))
    log = read_ulog_log(path)
    unknown = np.isnan(log.trace.array("cruise_speed_set_mps"))
    assert [bool(unknown[round((at - 5.0) / 0.05)]) for at in (8.0, 12.0, 29.0, 31.0)] == [
        False,
        streamed,
        streamed,
        False,
    ]
    given = [one.at_s for one in log.stimuli if one.name == NAME]
    assert given == (pytest.approx(np.arange(5.0, 25.0, 1.0), abs=0.01) if streamed else [])


def test_a_flood_of_targets_and_orders_takes_time_with_its_length() -> None:
    """Each target was compared with each order, each moment with each span: a log of a minute held for hours."""
    many = 200_000
    orders = np.arange(many, dtype=np.float64)
    assert _near(orders, orders + 0.5).sum() == 0
    assert _near(orders, orders + 0.1).all()
    columns = Columns()
    columns.hold("cruise_speed_set_mps", orders, np.full(many, 5.0))
    _forget(columns, [(2.0 * place, 2.0 * place + 1.0) for place in range(many)])
    course = columns.get("cruise_speed_set_mps")
    assert course is not None
    assert [bool(one) for one in np.isnan(course[1][:4])] == [True, False, True, False]
