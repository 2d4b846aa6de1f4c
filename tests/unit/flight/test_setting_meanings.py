"""Settings whose value means nothing here are not known: in flight and in logs they do not keep what they meant."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, dataflash, ulog

from saflite.console.operations.log_judging import judge_file
from saflite.flight.autopilots.ardupilot import settings as ardupilot_settings
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.px4.settings import shown_settings
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.settings import ARDUPILOT, PX4, Made, Plain, sources
from saflite.flight.logs.ulog import read_ulog_log

NAN = math.nan
PX4_CODES = [
    ("GF_ACTION", "fence_action_set", (3.0, 1.0), 4.0),
    ("GF_ACTION", "fence_action_set", (3.0, 1.0), -1.0),
    ("COM_POSCTL_NAVL", "fs_gps_action", (1.0, 1.0), 2.0),
    ("EKF2_HGT_REF", "altitude_source", (1.0, 2.0), 4.0),
    ("EKF2_HGT_REF", "altitude_source", (3.0, 3.0), -1.0),
    ("EKF2_HGT_MODE", "altitude_source", (2.0, 1.0), 4.0),
]
ARDUPILOT_CODES = [
    ("EK3_SRC1_POSZ", "altitude_source", (3.0, 2.0), 0.0),
    ("EK3_SRC1_POSZ", "altitude_source", (1.0, 0.0), 4.0),
    ("EK3_SRC1_POSZ", "altitude_source", (2.0, 1.0), 6.0),
    ("EK3_ALT_SOURCE", "altitude_source", (2.0, 2.0), 3.0),
    ("EK2_ALT_SOURCE", "altitude_source", (2.0, 2.0), 3.0),
]


def test_a_return_that_counts_from_the_terrain_has_no_height_that_a_log_tells() -> None:
    height = ARDUPILOT["rtl_altitude_set_m"]
    assert [height({"RTL_ALT": 1500.0, **given}) for given in ({}, {"RTL_ALT_TYPE": 0.0})] == [15.0, 15.0]
    assert math.isnan(height({"RTL_ALT": 1500.0, "RTL_ALT_TYPE": 1.0}))


def test_a_px4_that_looks_for_its_landing_place_may_wait_at_any_height() -> None:
    height = PX4["rtl_descend_altitude_set_m"]
    assert [height({"RTL_DESCEND_ALT": 10.0, **given}) for given in ({}, {"RTL_PLD_MD": 0.0})] == [10.0, 10.0]
    assert math.isnan(height({"RTL_DESCEND_ALT": 10.0, "RTL_PLD_MD": 2.0}))


@pytest.mark.parametrize("table", [ARDUPILOT, PX4], ids=["ArduPilot", "PX4"])
@pytest.mark.parametrize("value", [-1e9, -1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 100.0, NAN, math.inf])
def test_no_value_of_a_parameter_is_as_if_it_were_not_there(value: float, table: dict[str, Plain | Made]) -> None:
    for signal, words in sources(table).items():
        given = dict.fromkeys(re.findall(r"[A-Z][A-Z0-9_]{4,}", words), value)
        assert isinstance(table[signal](given), float), signal


@pytest.mark.parametrize(("name", "signal", "known", "other"), PX4_CODES)
def test_a_px4_setting_without_meaning_is_not_known_in_flight_and_in_its_log(
    name: str, signal: str, known: tuple[float, float], other: float, tmp_path: Path
) -> None:
    value, meant = known
    assert shown_settings({name: value})[signal] == meant
    assert math.isnan(shown_settings({name: other})[signal])
    path = tmp_path / "flight.ulg"
    path.write_bytes(px4_flight(name, value, (7.0, other), (15.0, value)))
    shown = read_ulog_log(path).trace.array(signal)
    np.testing.assert_array_equal(shown[[100, 180, 360]], [meant, NAN, meant])


def px4_flight(name: str, first: float, *later: tuple[float, float]) -> bytes:
    """A flight of 20 s from 1 s on that breaches its fence at 12 s and flies on; a parameter is set at some times."""
    rows: list[tuple[str, float, tuple[float, ...]]] = [
        ("vehicle_local_position", 1 + n / 10, (0.0, 0.0, -9.0, 0.0, 0.0, 0.0, True)) for n in range(200)
    ]
    rows += [("vehicle_status", 1.0, (2, 2))]
    rows += [("failsafe_flags", t, (0, int(t >= 12.0))) for t in (1.0, 12.0)]
    rows += [("vehicle_land_detected", t, (int(t < 2.0),)) for t in (1.0, 2.0)]
    rows += [(name, at_s + 0.05, (value,)) for at_s, value in later]
    topics = {
        "vehicle_local_position": POSITION,
        "vehicle_status": STATUS,
        "failsafe_flags": [("?", "local_position_invalid"), ("?", "geofence_breached")],
        "vehicle_land_detected": [("?", "landed")],
    }
    return ulog(topics, sorted(rows, key=lambda row: row[1]), {name: first})


@pytest.mark.parametrize(
    ("first", "later", "outcome"),
    [(3.0, [], "violated"), (3.0, [(7.0, 4.0)], "inconclusive"), (4.0, [], "inconclusive"), (1.0, [], "vacuous")],
)
def test_a_rule_does_not_judge_by_what_a_setting_meant_before(
    first: float, later: list[tuple[float, float]], outcome: str, tmp_path: Path
) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(px4_flight("GF_ACTION", first, *later))
    (verdict,) = judge_file(path, None, ("fence-action",)).verdicts
    assert verdict.outcome == outcome
    assert outcome != "inconclusive" or "fence_action_set" in verdict.message


@pytest.mark.parametrize(("name", "signal", "known", "other"), ARDUPILOT_CODES)
def test_an_ardupilot_setting_without_meaning_is_not_known_in_flight_and_in_its_log(
    name: str, signal: str, known: tuple[float, float], other: float, tmp_path: Path
) -> None:
    value, meant = known
    vehicle = Vehicle(np.zeros((0, 8)), 0.0)
    for given, shown in ((value, meant), (other, NAN), (value, meant)):
        ardupilot_settings.show(vehicle, {name: given})
        np.testing.assert_array_equal(vehicle[signal], shown)
    rows = [("PARM", (int(at_s * 1e6), name.encode(), told)) for at_s, told in ((1, value), (7, other), (15, value))]
    assert_logged(rows, signal, [meant, NAN, meant], tmp_path)


def test_a_source_of_height_is_asked_for_by_the_filter_that_flies(tmp_path: Path) -> None:
    both = {"EK2_ALT_SOURCE": 2.0, "EK3_SRC1_POSZ": 2.0}
    vehicle = Vehicle(np.zeros((0, 8)), 0.0)
    for flies, shown in ((2.0, 2.0), (3.0, 1.0)):
        ardupilot_settings.show(vehicle, {**both, "AHRS_EKF_TYPE": flies})
        assert vehicle["altitude_source"] == shown
        told = {**both, "AHRS_EKF_TYPE": flies}
        rows = [("PARM", (1_000_000, name.encode(), value)) for name, value in told.items()]
        assert_logged(rows, "altitude_source", [shown] * 3, tmp_path)


def assert_logged(rows: list[tuple[str, tuple[Any, ...]]], signal: str, expected: list[float], tmp_path: Path) -> None:
    hovers = [("XKF1", (1_000_000 + n * 100_000, 0, 0.0, 0.0, -9.0, 0.0, 0.0, 0.0)) for n in range(200)]
    path = tmp_path / "flight.bin"
    kinds = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value")}
    path.write_bytes(dataflash(kinds, sorted([*hovers, *rows], key=lambda row: row[1][0])))
    np.testing.assert_array_equal(read_dataflash_log(path).trace.array(signal)[[100, 180, 360]], expected)
