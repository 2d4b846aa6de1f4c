"""Of a PX4 log: an attitude that was lost for good is a crash, what cannot be told of one is not told; motors' load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, ardupilot_flight, ulog

from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.ulog import read_ulog_log

STABILIZE, ACRO, TERMINATION = 15, 10, 13
ACRO_OF_ARDUPILOT, FLIP, THROW, TURTLE = 1, 14, 18, 28
UP_S, END_S = 3.0, 30.0
Spans = Sequence[tuple[float, float]]


def within(at_s: float, spans: Spans) -> bool:
    return any(start <= at_s < end for start, end in spans)


def written(
    tmp_path: Path,
    *,
    lost: Spans = (),
    ended: Spans = (),
    down: Spans = (),
    armed: Spans = ((2.0, 25.0),),
    mode: int = STABILIZE,
    parameters: dict[str, float] | None = None,
    motors: tuple[float, ...] = (0.4, 0.5, 0.6, 0.5),
    older: bool = False,
    hits: Spans = (),
    end_s: float = END_S,
) -> Path:
    """Flown from 3 s on, 10 m up, on the ground again in the spans of `down`; `lost`: what the detector says.

    In the spans of `hits` the accelerometer measures 30 times what gravity pulls with.
    """
    topics = {
        "vehicle_local_position": POSITION,
        "vehicle_status": [*STATUS, ("H", "failure_detector_status")] if older else STATUS,
        "vehicle_land_detected": [("?", "landed")],
        "vehicle_control_mode": [("?", "flag_control_termination_enabled")],
        "actuator_motors": [("f", f"control[{i}]") for i in range(len(motors))],
    }
    if hits:
        topics["sensor_combined"] = [("f", f"accelerometer_m_s2[{i}]") for i in range(3)]
    if not older:
        topics["failure_detector_status"] = [("?", "fd_roll"), ("?", "fd_pitch")]
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(10, int(end_s * 10)):
        at_s = tenth / 10
        stands = at_s < UP_S or within(at_s, down)
        rows.append(("vehicle_local_position", at_s, (0.0, 0.0, 0.0 if stands else -10.0, 0.0, 0.0, 0.0, True)))
        status = (mode, 2 if within(at_s, armed) else 1)
        rows.append(("vehicle_status", at_s, (*status, 2 * within(at_s, lost)) if older else status))
        rows.append(("vehicle_land_detected", at_s, (stands,)))
        rows.append(("vehicle_control_mode", at_s, (within(at_s, ended),)))
        rows.append(("actuator_motors", at_s, motors))
        if hits:
            rows.append(("sensor_combined", at_s, (0.0, 100.0, -280.0) if within(at_s, hits) else (0.0, 0.0, -9.81)))
        if not older:
            rows.append(("failure_detector_status", at_s, (False, within(at_s, lost))))
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, rows, parameters))
    return path


def crashed(log: FlightLog, at_s: float) -> float:
    """Return the signal at a moment of the log's own time, which begins at 1 s."""
    return float(log.trace.array("crashed")[round((at_s - 1.0) / log.trace.step_s)])


LANDS = ((24.0, END_S),)


@pytest.mark.parametrize("older", [False, True])
def test_who_tumbles_until_the_motors_stop_has_crashed(older: bool, tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, lost=((20.0, END_S),), older=older))
    assert log.crashed
    assert [crashed(log, at_s) for at_s in (10.0, 19.5, 20.5, 28.0)] == [0.0, 0.0, 1.0, 1.0]


def test_who_is_terminated_for_it_has_crashed_though_nothing_watches_any_more(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, lost=((20.0, 20.5),), ended=((20.4, END_S),)))
    assert [crashed(log, at_s) for at_s in (19.5, 21.0, 28.0)] == [0.0, 1.0, 1.0]


def test_who_catches_himself_and_lands_has_not_crashed(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, lost=((10.0, 11.0),), down=LANDS))
    assert not log.crashed
    assert [crashed(log, at_s) for at_s in (10.5, 20.0, 28.0)] == [0.0, 0.0, 0.0]


def test_who_hits_the_ground_with_his_attitude_lost_has_crashed_though_he_lies_level(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, lost=((10.0, 10.5),), hits=((11.0, 11.1),), down=((11.0, END_S),)))
    assert log.crashed
    assert [crashed(log, at_s) for at_s in (9.5, 12.0, 20.0, 28.0)] == [0.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize("hits", [((8.0, 8.1),), ((18.0, 18.1),)])
def test_a_hit_before_an_attitude_is_lost_or_long_after_is_no_crash(hits: Spans, tmp_path: Path) -> None:
    assert not read_ulog_log(written(tmp_path, lost=((10.0, 11.0),), hits=hits, down=LANDS)).crashed


def test_who_is_terminated_in_level_flight_or_disarmed_in_the_air_came_down_nobody_knows_how(tmp_path: Path) -> None:
    for ended in ((), ((20.0, END_S),)):
        log = read_ulog_log(written(tmp_path, ended=ended))
        assert not log.crashed
        assert crashed(log, 19.0) == 0.0
        assert math.isnan(crashed(log, 28.0))


def test_in_acro_nothing_watches(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, mode=ACRO, down=LANDS))
    assert math.isnan(crashed(log, 20.0))


@pytest.mark.parametrize("name", ["FD_FAIL_R", "FD_FAIL_P"])
def test_a_detector_that_is_switched_off_tells_nothing(name: str, tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, parameters={name: 0.0}, down=LANDS))
    assert "crashed" not in log.trace.signals


def test_who_is_armed_again_has_not_crashed_yet(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, lost=((8.0, 10.0),), armed=((2.0, 9.0), (14.0, 25.0)), down=LANDS))
    assert [crashed(log, at_s) for at_s in (8.5, 12.0, 20.0)] == [1.0, 1.0, 0.0]


def test_the_load_is_the_mean_of_the_motors_there_are_while_armed(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, motors=(0.4, 0.5, 0.6, 0.7, math.nan, math.nan), down=LANDS))
    load, armed = log.trace.array("throttle"), log.trace.array("armed") > 0
    assert np.allclose(load[armed], 0.55)
    assert np.isnan(load[~armed]).all()


def test_motors_that_all_stand_have_no_load(tmp_path: Path) -> None:
    log = read_ulog_log(written(tmp_path, motors=(math.nan,) * 4))
    assert log.trace.array("throttle")[round(10.0 / log.trace.step_s)] == 0.0


def test_who_hits_something_and_flies_on_has_not_crashed(tmp_path: Path) -> None:
    stopped = written(tmp_path, lost=((10.0, 10.5),), hits=((11.0, 11.1),), down=((11.0, END_S),))
    assert read_ulog_log(stopped).crashed
    for off_s in (40.0, 60.0):
        goes_on = written(tmp_path, lost=((4.0, 4.5),), hits=((5.0, 5.1),), armed=((2.0, off_s),), end_s=45.0)
        assert not read_ulog_log(goes_on).crashed


LEANS = {
    **KINDS,
    "ATT": ("Qff", "TimeUS,Roll,Pitch"),
    "VIBE": ("QBI", "TimeUS,IMU,Clip"),
    "PARM": ("QNf", "TimeUS,Name,Value"),
}


def dropped(
    tmp_path: Path,
    *,
    lean_deg: float = 80.0,
    hit_s: float = 7.0,
    mode: int = 0,
    off_s: float = 9.0,
    leans_s: tuple[float, float] = (6.0, 99.0),
    again_s: tuple[float, float] | None = None,
    end_s: float = 11.0,
    angle_max_deg: float = 45.0,
) -> FlightLog:
    """Leans over in `leans_s`, an accelerometer is at its end at `hit_s`, the motors are stopped at `off_s`.

    They run again in `again_s`. What stops them lies after the log's end, or never comes, where that is before it.
    """
    more: list[tuple[str, tuple[Any, ...]]] = [
        ("PARM", (1_000_001, b"ANGLE_MAX", angle_max_deg * 100)),
        ("MODE", (1_500_000, mode, mode, 1)),
    ]
    more += [("EV", (round(at_s * 1e6), number)) for at_s, number in zip(again_s or (), (10, 11), strict=False)]
    more += [("EV", (round(off_s * 1e6), 11))] if off_s < end_s else []
    for tenth in range(10, round(end_s * 10)):
        at = tenth * 100_000
        more.append(("ATT", (at, lean_deg if leans_s[0] <= at / 1e6 < leans_s[1] else 2.0, 1.0)))
        more.append(("VIBE", (at, 0, 3 + 2 * (at >= hit_s * 1e6))))
        more.append(("VIBE", (at, 1, 7)))
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight(LEANS, more=sorted(more, key=lambda row: row[1][0])))
    return read_dataflash_log(path)


def test_a_copter_that_hits_something_leaning_over_has_crashed(tmp_path: Path) -> None:
    log = dropped(tmp_path)
    assert log.crashed
    assert [crashed(log, at_s) for at_s in (6.5, 8.0)] == [0.0, 1.0]


@pytest.mark.parametrize("otherwise", [{"angle_max_deg": 70.0, "lean_deg": 100.0}, {"off_s": 30.0}], ids=str)
def test_a_copter_that_hits_something_has_crashed_whatever_it_may_lean_and_though_the_log_ends(
    otherwise: dict[str, float], tmp_path: Path
) -> None:
    assert dropped(tmp_path, **otherwise).crashed  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "otherwise",
    [
        {"lean_deg": 40.0},
        {"hit_s": 5.0},
        {"hit_s": 20.0},
        *({"mode": mode} for mode in (ACRO_OF_ARDUPILOT, FLIP, THROW, TURTLE)),
        {"lean_deg": 75.0, "angle_max_deg": 80.0},
        {"off_s": 5.0},
        {"off_s": 5.0, "leans_s": (6.0, 8.0), "again_s": (8.5, 10.5)},
        {"off_s": 90.0, "end_s": 60.0, "leans_s": (6.0, 6.5)},
    ],
    ids=str,
)
def test_who_leans_little_or_turns_over_on_purpose_or_in_hands_or_hits_nothing_then_or_flies_on_has_not(
    otherwise: dict[str, Any], tmp_path: Path
) -> None:
    assert not dropped(tmp_path, **otherwise).crashed


@pytest.mark.parametrize("letters", ["QBN", "QNI"])
def test_counters_that_are_no_numbers_count_nothing(letters: str, tmp_path: Path) -> None:
    rows: list[tuple[str, tuple[Any, ...]]] = [("EV", (9_000_000, 11))]
    for at in range(1_000_000, 9_000_000, 100_000):
        rows += [("ATT", (at, 80.0, 1.0)), ("VIBE", (at, 0, b"many") if letters == "QBN" else (at, b"first", 4))]
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight({**LEANS, "VIBE": (letters, "TimeUS,IMU,Clip")}, more=rows))
    assert not read_dataflash_log(path).crashed
