"""What logs of real autopilots tell of orders: who stopped the motors, and whether somebody ordered it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.ulog import read_ulog_log
from saflite.flight.logs.ulog_commands import commands_of

ARM = {"ARM": ("QBBB", "TimeUS,ArmState,ArmChecks,Forced")}
MAVC = {"MAVC": ("QHfffffff", "TimeUS,Cmd,P1,P2,P3,P4,X,Y,Z")}
ARMED, DISARMED, LANDED, STOPPED, STOP_CLEARED, INTERLOCKED, RUNNING = 10, 11, 18, 54, 55, 56, 57
NAN = math.nan
Row = tuple[str, tuple[Any, ...]]


def us(at_s: float) -> int:
    return round(at_s * 1e6)


def event(at_s: float, number: int) -> Row:
    return ("EV", (us(at_s), number))


def height(at_s: float, height_m: float, falls_s: float) -> float:
    """From 3 s on in the air, and from `falls_s` on down to the ground."""
    return 0.0 if at_s < 3.0 else max(0.0, height_m - 5.0 * max(0.0, at_s - falls_s) ** 2)


def ardupilot(tmp_path: Path, *told: Row, height_m: float = 20.0, falls_s: float = math.inf) -> Path:
    """A log of 20 s from 1 s on: on the ground, from 3 s on in the air."""
    heights = [height(1 + tenth / 10, height_m, falls_s) for tenth in range(200)]
    rows: list[Row] = [
        ("XKF1", (1_000_000 + tenth * 100_000, 0, 0.0, 0.0, -height, 0.0, 0.0, 0.0))
        for tenth, height in enumerate(heights)
    ]
    rows += [("MODE", (1_000_000, 5, 5, 1)), event(2.0, ARMED), event(2.1, RUNNING), event(3.0, 28)]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash({**KINDS, **ARM, **MAVC}, [*rows, *told]))
    return path


def outcome(path: Path, policy: str = "armed-in-flight") -> str:
    (verdict,) = judge_file(path, None, (policy,)).verdicts
    return verdict.outcome


def test_the_interlock_that_follows_a_disarm_is_no_order_to_stop(tmp_path: Path) -> None:
    path = ardupilot(tmp_path, event(10.0, DISARMED), event(10.003, INTERLOCKED), falls_s=10.0)
    assert set(read_dataflash_log(path).trace.array("stop_ordered")) == {0.0}
    assert outcome(path) == "violated"


@pytest.mark.parametrize(
    ("told", "height_m", "known"),
    [
        (
            [event(10.0, DISARMED), event(10.0, LANDED)],
            20.0,
            [0, NAN, NAN],
        ),  # falls, and who is disarmed looks at nothing
        ([event(10.0, DISARMED), event(10.0, LANDED), event(15.0, ARMED)], 20.0, [0, NAN, 0]),
        ([event(9.0, LANDED), event(10.0, DISARMED)], 20.0, [0, 0, 0]),  # on a roof
        ([event(10.0, DISARMED)], 1.0, [0, 0, 0]),
        ([("ERR", (us(9.0), 12, 1)), event(10.0, DISARMED)], 20.0, [0, 1, 1]),
    ],
)
def test_of_a_crash_after_a_disarm_in_the_air_an_ardupilot_log_tells_nothing(
    told: list[Row], height_m: float, known: list[float], tmp_path: Path
) -> None:
    log = read_dataflash_log(ardupilot(tmp_path, *told, height_m=height_m))
    crashed = log.trace.array("crashed")
    np.testing.assert_array_equal([crashed[round((at_s - 1.0) / 0.05)] for at_s in (8.0, 12.0, 18.0)], known)
    assert log.crashed == (1 in known)


def test_a_fence_that_stays_broken_is_broken_until_it_was_last_said_to_be_over(tmp_path: Path) -> None:
    """ArduCopter 4.5.7 says so 25 times a second, from the first look after the breach on."""
    over = [("ERR", (us(6.0 + tenth / 10), 9, 0)) for tenth in range(31)]
    told: list[Row] = [("ERR", (us(5.9), 9, 1)), *over, ("ERR", (us(14.0), 9, 2)), ("ERR", (us(15.0), 9, 0))]
    broken = read_dataflash_log(ardupilot(tmp_path, *told)).trace.array("failsafe_fence")
    at_s = (5.0, 5.95, 8.95, 9.05, 13.9, 14.1, 15.1)
    assert [broken[round((one - 1.0) / 0.05)] for one in at_s] == [0, 1, 1, 0, 0, 1, 0]


@pytest.mark.parametrize(
    "told",
    [
        [event(10.0, STOPPED), event(10.003, INTERLOCKED), event(11.0, DISARMED)],
        [event(10.0, INTERLOCKED), event(11.0, DISARMED)],
        [event(10.0, DISARMED), ("ARM", (us(10.0), 0, 0, 1)), event(10.003, INTERLOCKED)],
        [event(10.0, DISARMED), ("MAVC", (us(10.001), 400, 0, 21196, 0, 0, 0, 0, 0)), event(10.003, INTERLOCKED)],
        [event(10.0, DISARMED), ("MAVC", (us(10.001), 185, 1, 0, 0, 0, 0, 0, 0)), event(10.003, INTERLOCKED)],
    ],
    ids=["emergency stop", "interlock", "forced, by ARM", "forced, by MAVC", "termination"],
)
def test_who_orders_the_motors_to_stop_is_not_told_off_for_it(told: list[Row], tmp_path: Path) -> None:
    assert outcome(ardupilot(tmp_path, *told)) == "vacuous"


@pytest.mark.parametrize(
    "after", [[event(12.0, STOP_CLEARED)], [event(12.0, RUNNING)], [event(11.0, DISARMED), event(12.0, ARMED)]]
)
def test_an_order_to_stop_counts_until_it_is_taken_back_or_the_motors_are_armed_again(
    after: list[Row], tmp_path: Path
) -> None:
    told = [event(10.0, STOPPED), event(10.003, INTERLOCKED), *after]
    again = ardupilot(tmp_path, *told, event(15.0, DISARMED), event(15.003, INTERLOCKED), falls_s=15.0)
    stops = read_dataflash_log(again).trace.array("stop_ordered")
    assert [stops[round((at_s - 1.0) / 0.05)] for at_s in (9.0, 10.5, 12.5, 16.0)] == [0, 1, 0, 0]
    assert outcome(again) == "violated"


def test_a_disarm_that_was_forced_does_not_force_an_arming(tmp_path: Path) -> None:
    forced_off = ardupilot(tmp_path, ("ARM", (us(10.0), 0, 0, 1)))
    assert "arming_forced" not in read_dataflash_log(forced_off).trace.signals
    forced_on = ardupilot(tmp_path, ("ARM", (us(10.0), 1, 0, 1)))
    assert set(read_dataflash_log(forced_on).trace.array("arming_forced")[200:]) == {1.0}


COMMAND = [("H", "command"), ("?", "from_external"), *(("f", f"param{n}") for n in range(1, 8))]
ACTUATORS = [("?", "armed"), ("?", "kill")]
Told = tuple[str, float, tuple[float, ...]]


def px4(tmp_path: Path, *told: Told, falls_s: float = math.inf) -> Path:
    """A log of 20 s from 1 s on: on the ground, armed at 2 s, from 3 s on in the air."""
    topics = {
        "vehicle_local_position": POSITION,
        "vehicle_status": STATUS,
        "vehicle_command": COMMAND,
        "vehicle_command_ack": [("H", "command"), ("B", "result")],
        "actuator_armed": ACTUATORS,
    }
    rows: list[Told] = [
        ("vehicle_local_position", 1 + n / 10, (0.0, 0.0, -height(1 + n / 10, 20.0, falls_s), 0.0, 0.0, 0.0, True))
        for n in range(200)
    ]
    rows += [("vehicle_status", 1.0, (2, 1)), ("vehicle_status", 2.0, (2, 2)), ("actuator_armed", 1.0, (False, False))]
    rows += [("actuator_armed", 2.0, (True, False))]
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, [*rows, *told]))
    return path


def disarmed(at_s: float) -> list[Told]:
    return [("vehicle_status", at_s, (2, 1)), ("actuator_armed", at_s, (False, False))]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((400, True, 0.0, 21196.0), "vacuous"),
        ((185, True, 1.0, 0.0), "vacuous"),
        ((400, True, 0.0, 0.0), "violated"),
        ((400, False, 0.0, 21196.0), "violated"),  # by itself
    ],
)
def test_a_stop_ordered_by_command_is_one_in_a_px4_log(
    given: tuple[int, bool, float, float], expected: str, tmp_path: Path
) -> None:
    command = ("vehicle_command", 10.0, (*given, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert outcome(px4(tmp_path, command, *disarmed(10.02), falls_s=10.0)) == expected


@pytest.mark.parametrize(
    ("answer", "expected"),
    [((400, 0), "vacuous"), ((400, 5), "vacuous"), ((400, 2), "violated"), ((176, 2), "vacuous")],
)
def test_a_stop_that_a_px4_refused_is_none(answer: tuple[int, int], expected: str, tmp_path: Path) -> None:
    command = ("vehicle_command", 10.0, (400, True, 0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    path = px4(tmp_path, command, ("vehicle_command_ack", 10.01, answer), *disarmed(10.02), falls_s=10.0)
    assert outcome(path) == expected


def test_a_px4_stopped_by_switch_is_judged_again_once_it_is_armed_again(tmp_path: Path) -> None:
    killed: list[Told] = [("actuator_armed", 10.0, (True, True)), ("actuator_armed", 10.5, (True, False))]
    assert outcome(px4(tmp_path, *killed, *disarmed(11.0))) == "vacuous"
    again: list[Told] = [("vehicle_status", 12.0, (2, 2)), ("actuator_armed", 12.0, (True, False)), *disarmed(15.0)]
    path = px4(tmp_path, *killed, *disarmed(11.0), *again, falls_s=15.0)
    assert [read_ulog_log(path).trace.array("stop_ordered")[n] for n in (170, 190, 230)] == [0, 1, 0]
    assert outcome(path) == "violated"


@pytest.mark.parametrize(
    ("raised", "outcome_of"),
    [
        ([(1.0, True)], "violated"),  # HITL: locked from power-up on
        ([(2.0, True)], "violated"),  # as it is armed
        ([(1.0, True), (6.0, False), (9.0, True)], "vacuous"),
        ([(1.0, True), (6.0, False), (7.0, True), (8.0, False)], "vacuous"),  # counts until it is armed again
        ([(9.0, True)], "vacuous"),
    ],
)
def test_a_lock_that_is_up_as_a_px4_is_armed_is_no_order(
    raised: list[tuple[float, bool]], outcome_of: str, tmp_path: Path
) -> None:
    def locked(at_s: float) -> bool:
        return next((up for since_s, up in reversed(raised) if at_s >= since_s), False)

    rows: list[Told] = [("actuator_armed", n / 10, (20 <= n < 100, locked(n / 10))) for n in range(10, 210)]
    disarm: Told = ("vehicle_status", 10.0, (2, 1))
    assert outcome(px4(tmp_path, *rows, disarm, falls_s=10.0)) == outcome_of


PARM = {"PARM": ("QNf", "TimeUS,Name,Value")}
FENCE_ON, FENCE_OFF = 41, 42


def parameter(at_s: float, name: str, value: float) -> Row:
    return ("PARM", (us(at_s), name.encode(), value))


@pytest.mark.parametrize(
    ("enabled", "told", "shown", "by_hand"),
    [
        (1, [event(5.0, FENCE_OFF)], [1, 0, 0, 0], []),
        (0, [event(5.0, FENCE_ON)], [0, 1, 1, 1], []),
        (1, [event(5.0, FENCE_OFF), event(10.0, FENCE_ON)], [1, 0, 1, 1], []),
        (1, [event(5.0, FENCE_OFF), parameter(10.0, "FENCE_ENABLE", 1)], [1, 0, 1, 1], []),
        (1, [parameter(5.0, "FENCE_ENABLE", 0), event(15.0, FENCE_ON)], [1, 0, 0, 1], ["FENCE_ENABLE"]),
        (1, [event(5.0, FENCE_OFF), parameter(10.0, "FENCE_RADIUS", 50)], [1, 0, 0, 0], ["FENCE_RADIUS"]),
    ],
)
def test_a_fence_is_on_as_it_was_switched_last_by_setting_or_order(
    enabled: float, told: list[Row], shown: list[int], by_hand: list[str], tmp_path: Path
) -> None:
    rows = [parameter(1.0, "FENCE_ENABLE", enabled), parameter(1.0, "FENCE_TYPE", 1.0), *told]
    rows.append(parameter(1.0, "FENCE_RADIUS", 100.0))
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash({**KINDS, **PARM}, [*hovering(), *sorted(rows, key=lambda row: row[1][0])]))
    log = read_dataflash_log(path)
    for name in ("fence_on_set", "fence_enabled"):
        assert [log.trace.array(name)[round((at_s - 1.0) / 0.05)] for at_s in (3.0, 7.0, 12.0, 18.0)] == shown
    assert [one.name for one in log.stimuli] == by_hand, "an order sets no parameter"


def hovering() -> list[Row]:
    return [("XKF1", (us(1 + tenth / 10), 0, 0.0, 0.0, -20.0, 0.0, 0.0, 0.0)) for tenth in range(200)]


def test_each_of_two_like_orders_has_its_own_answer() -> None:
    """Both went by the first answer: where that was a refusal the order that was taken was left out, too."""
    ordered = {"command": np.array([192, 192]), "from_external": np.array([True, True])}
    topics = {
        "vehicle_command": {"timestamp": np.array([10_000_000, 10_020_000]), **ordered},
        "vehicle_command_ack": {
            "timestamp": np.array([10_030_000, 10_040_000]),
            "command": np.array([192, 192]),
            "result": np.array([1, 0]),
        },
    }
    assert [one.at_s for one in commands_of(topics)] == [10.02]
