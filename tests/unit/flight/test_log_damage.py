"""A log with holes is judged by what can be read of it, and what was lost is said."""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, ardupilot_flight, px4_flight, ulog

from saflite.console.cli import main
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase, identity
from saflite.contract.verdict import Verdict
from saflite.flight.logs import dataflash_damage, dataflash_rows, ulog_bounds
from saflite.flight.logs.dataflash_damage import sound
from saflite.flight.logs.files import read_log
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import RECEIVERS_MAX
from saflite.oracle.judge import judge

FMT_BYTES = 89
NUMBERS = {name: 10 + place for place, name in enumerate(KINDS)}  # as `log_bytes.dataflash` counts them


def read(data: bytes, folder: Path, name: str = "log.bin") -> FlightLog:
    (folder / name).write_bytes(data)
    return read_log(folder / name)


def described(data: bytes, name: str) -> int:
    """Return where the description of a kind stands."""
    return next(
        place for place in range(0, len(data), FMT_BYTES) if data[place + 5 : place + 9].startswith(name.encode())
    )


def changed(name: str, offset: int, value: bytes) -> bytes:
    data = bytearray(ardupilot_flight())
    place = described(bytes(data), name) + offset
    data[place : place + len(value)] = value
    return bytes(data)


DAMAGES = {
    "a letter that is none": (9, b"!"),
    "a letter of another size": (10, b"d"),
    "its number": (3, b"\xc8"),
    "its mark": (0, b"\0\0\0"),
    "all of it": (0, bytes(FMT_BYTES)),
    "its name": (5, b"\x07"),
    "a comma between its fields": (31, b"x"),
}


@pytest.mark.parametrize("name", ["EV", "MODE", "ERR"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_description_costs_its_own_messages_and_says_so(damage: str, name: str, tmp_path: Path) -> None:
    found = read(changed(name, *DAMAGES[damage]), tmp_path)
    assert found.trace.duration_s == pytest.approx(10.0, abs=0.06)
    assert found.trace.array("x_m")[100] == pytest.approx(5.0, abs=1e-3)
    (said,) = found.lost
    assert "left out" in said
    assert name in said or f"number {NUMBERS[name]}" in said
    kept = {"EV": "mode", "MODE": "armed", "ERR": "mode"}[name]
    lost = {"EV": "chute_released", "MODE": "mode", "ERR": None}[name]
    assert kept in found.trace.signals
    assert lost not in found.trace.signals


@pytest.mark.parametrize("length", [0, 2, 30, 255])
def test_a_damaged_length_is_that_of_the_fields(length: int, tmp_path: Path) -> None:
    whole = read(ardupilot_flight(), tmp_path)
    found = read(changed("MODE", 4, bytes([length])), tmp_path)
    assert (found.trace, found.lost) == (whole.trace, ())


def test_a_number_that_is_another_kinds_mixes_up_neither(tmp_path: Path) -> None:
    found = read(changed("EV", 3, bytes([NUMBERS["XKF1"]])), tmp_path)
    assert found.trace.array("x_m")[100] == pytest.approx(5.0, abs=1e-3)
    assert "chute_released" not in found.trace.signals
    assert len(found.lost) == 1


@pytest.mark.parametrize("fill", [bytes(300), b"\xa3\x95" * 150, b"\xa3\x95\x0a" * 100])
def test_a_hole_costs_what_lay_there(fill: bytes, tmp_path: Path) -> None:
    data = ardupilot_flight()
    middle = len(data) // 3
    found = read(data[:middle] + fill + data[middle + len(fill) :], tmp_path)
    assert found.lost
    assert found.trace.duration_s == pytest.approx(10.0, abs=0.06)
    assert found.trace.array("x_m")[[10, 190]] == pytest.approx([0.5, 9.5], abs=1e-2)


@pytest.mark.parametrize("tail", [b"", bytes(249), b"\xff" * 249, b"\xa3\x95\x0a\0\0"])
def test_the_rest_of_a_page_after_the_last_message_is_no_damage(tail: bytes, tmp_path: Path) -> None:
    assert read(ardupilot_flight() + tail, tmp_path).lost == ()


def test_a_hole_in_a_px4_log_is_told(tmp_path: Path) -> None:
    data = px4_flight()
    assert read(data, tmp_path, "log.ulg").lost == ()
    place = len(data) // 2
    found = read(data[:place] + b"\xff" * 90 + data[place + 90 :], tmp_path, "log.ulg")
    assert len(found.lost) == 1


@pytest.mark.parametrize("more", [(), ("--quiet",), ("--json",)])
def test_what_was_lost_is_said_whatever_else_is_printed(
    more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(changed("EV", 9, b"!"))
    main(["judge", str(path), *more])
    said = capsys.readouterr()
    assert "the description of EV is damaged: its 2 messages are left out" in said.err
    assert "damaged" not in said.out


def holed(known: Callable[[float], bool]) -> bytes:
    """A PX4 log of 90 s along x at 1 m/s, 20 m up, with a position ten times a second wherever one is known."""
    times = [tenth / 10 for tenth in range(900) if known(tenth / 10)]
    rows: list[tuple[str, float, tuple[float, ...]]] = [("vehicle_status", 0.0, (3, 2))]
    rows += [("vehicle_local_position", at, (at, 0.0, -20.0, 1.0, 0.0, 0.0, True)) for at in times]
    topics = {"vehicle_local_position": POSITION, "vehicle_status": STATUS}
    return ulog(topics, sorted(rows, key=lambda row: row[1]))


def beside(x_m: float, path: Path) -> Verdict:
    """Return the verdict on the way past a box beside the middle of it."""
    box = Obstacle(length_m=2, width_m=2, height_m=30, x_m=35.0, y_m=x_m)
    case = TestCase(target=Target(name="px4"), scenario=Scenario(obstacles=(box,)))
    flight = Flight(test_case=identity(case), flight_index=0, ending="completed")
    return judge(case, flight, read_log(path).trace, ("min-obstacle-distance",)).verdicts[0]


def test_a_way_that_was_not_logged_is_no_evidence(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    path.write_bytes(holed(lambda at_s: not 20 <= at_s < 50))
    verdict = beside(5.0, path)
    assert verdict.outcome == "inconclusive"
    assert verdict.message == "not known all the time: obstacle_distance_m (from 20.0 s)"
    path.write_bytes(holed(lambda at_s: not 60 <= at_s < 80))
    assert beside(1.5, path).outcome == "violated"  # before the hole
    path.write_bytes(holed(lambda at_s: not 20 <= at_s < 23))
    assert beside(5.0, path).outcome == "held"  # as short as a radio link may be silent


def test_slow_signals_have_no_holes_and_none_is_drawn_beyond_its_ends() -> None:
    columns, times = Columns(), np.arange(0.0, 100.0, 0.1)
    for name in ("x_m", "y_m", "altitude_m"):
        columns.add(name, times, np.zeros_like(times))
    columns.add("battery_v", np.arange(0.0, 101.0, 10.0), np.full(11, 12.0))
    columns.add("climb_mps", times[300:600], np.ones(300))
    columns.add("tilt_deg", times[:100] + 500.0, np.ones(100))
    trace = columns.trace("log", "x.ulg")
    assert "tilt_deg" not in trace.signals, "of another time altogether"
    assert not np.isnan(trace.array("battery_v")).any()
    known = np.flatnonzero(~np.isnan(trace.array("climb_mps"))) * trace.step_s
    assert (known[0], known[-1]) == pytest.approx((25.0, 64.9), abs=0.06)


def test_descriptions_that_contradict_each_other_cost_a_few_looks_through_the_log() -> None:
    class Counted(bytes):
        looks = 0

        def find(self, *given: Any) -> int:
            Counted.looks += 1
            return super().find(*given)

    layout, many = struct.Struct("<3sBB4s16s64s"), 3000
    kinds = (layout.pack(b"\xa3\x95\x80", 1, 10, b"AAAA", b"B", b"c%d" % place) for place in range(many))
    sound(Counted(b"".join(kinds)))
    assert Counted.looks < 2 * many


@pytest.mark.parametrize("junk", [b"\xff", b"\xf0\xff\x99", b"\x11\x27\x00", b"\x2f"])
def test_bytes_of_no_px4_message_are_not_read_over_and_over(junk: bytes) -> None:
    """Each byte of 3 MB seemed to begin a message of 64 KiB, and all that was read before the next was looked at."""

    class Counted(io.BytesIO):
        taken = 0

        def read(self, size: int | None = -1) -> bytes:
            found = super().read(size)
            Counted.taken += len(found)
            return found

    data = px4_flight() + junk * (100_000 // len(junk))
    log = ulog_bounds.bounded()(Counted(data), ["vehicle_local_position"])
    assert log.data_list
    assert Counted.taken < 10 * len(data)


@pytest.mark.parametrize("kind", ["KEPT", "MESSAGES"])
def test_a_px4_log_of_more_messages_than_any_is_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """512 MiB of parameters, texts or drop-outs would have taken 12 GB; what the library skips counts, too."""
    text = b"\x0a\x00L4" + bytes(8) + b"a"
    for more in (text * 200, b"\x02\x00O\x05\x00" * 200, b"\x00\x00X" * 200):
        data = px4_flight() + more
        assert read(data, tmp_path, "log.ulg").trace.samples
        with monkeypatch.context() as patch:
            patch.setattr(ulog_bounds, f"{kind}_MAX", 150)
            if kind == "KEPT" and more.startswith(b"\x00"):
                assert read(data, tmp_path, "log.ulg").trace.samples
                continue
            with pytest.raises(Refused, match=r"PX4 log .*at most 150 messages, got more"):
                read(data, tmp_path, "log.ulg")


def test_receivers_without_number_are_told_apart_at_one_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """130 KB of rows, each of a receiver of its own, took two minutes: all were looked at again for each."""
    looks = Counter[str]()

    def counted(fields: dict[str, Any]) -> float:
        looks["all"] += 1
        return float(fields["I"])

    monkeypatch.setattr(dataflash_rows, "_instance", counted)
    told = [(0.1 * number, {"I": number % 300, "Status": 3 * (number % 300 == 7)}) for number in range(3000)]
    used = dataflash_rows._used_receiver({"GPS": told, "GPS2": []})
    assert {fields["I"] for _, fields in used} == {7}
    assert looks["all"] == len(told)


def test_more_receivers_than_px4_can_have_are_refused(tmp_path: Path) -> None:
    """2 MB took as many GB: for each row of all, each receiver was looked at."""
    names = ["sensor_gps", *(f"sensor_gps#{number}" for number in range(1, RECEIVERS_MAX + 1))]
    for count in (RECEIVERS_MAX, RECEIVERS_MAX + 1):
        topics = {"vehicle_local_position": POSITION, **{name: [("B", "fix_type")] for name in names[:count]}}
        rows = [("vehicle_local_position", 5 + tenth / 10, (0.0,) * 6 + (True,)) for tenth in range(100)]
        data = ulog(topics, [*rows, *((name, 6.0, (3,)) for name in names[:count])])
        if count == RECEIVERS_MAX:
            assert read(data, tmp_path, "log.ulg").trace.samples
            continue
        with pytest.raises(Refused, match=r"11 receivers of sensor_gps, more than 10"):
            read(data, tmp_path, "log.ulg")


@pytest.mark.parametrize("kind", ["messages", "pieces", "rows"])
def test_a_log_of_more_than_memory_should_hold_is_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """512 MiB of the smallest messages would have taken 20 GB."""
    module, name = (dataflash_rows, "ROWS_MAX") if kind == "rows" else (dataflash_damage, f"{kind.upper()}_MAX")
    assert getattr(module, name) >= 2**20
    data = ardupilot_flight() + (b"\xa3\x95\xfe" * 2000 if kind == "pieces" else b"")
    assert read(data, tmp_path).trace.samples
    monkeypatch.setattr(module, name, 100)
    with pytest.raises(Refused, match=r"at most 100 .*, got more") as told:
        read(data, tmp_path)
    assert str(tmp_path) in told.value.where
