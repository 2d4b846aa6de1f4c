"""Minimal logs of real autopilots, byte by byte after the formats' own descriptions."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

FLOATS = {"f": "float", "d": "double", "B": "uint8_t", "H": "uint16_t", "?": "bool"}


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(
    topics: dict[str, list[tuple[str, str]]],
    rows: Sequence[tuple[str, float, tuple[float, ...]]],
    parameters: dict[str, float] | None = None,
    began_s: float = 0.0,
) -> bytes:
    """A ULog file: per topic its fields (format, name), and rows (topic, seconds, values); `topic#1` is an instance.

    A row of a name that is no topic is a parameter that was set after the row before it.
    """
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(began_s * 1e6))
    data += message("B", bytes(40))
    for name, fields in topics.items():
        text = "".join(f"{FLOATS[code]} {field};" for code, field in fields)
        if "#" not in name:
            data += message("F", f"{name}:uint64_t timestamp;{text}".encode())
    for name, value in (parameters or {}).items():
        data += ulog_parameter(name, value)
    ids = {name: number for number, name in enumerate(topics)}
    for name, number in ids.items():
        topic, _, instance = name.partition("#")
        data += message("A", struct.pack("<BH", int(instance or 0), number) + topic.encode())
    for name, at_s, values in rows:
        if name not in topics:
            data += ulog_parameter(name, *values)
            continue
        codes = "".join(code for code, _ in topics[name])
        data += message("D", struct.pack("<HQ" + codes, ids[name], int(at_s * 1e6), *values))
    return data + message("L", bytes([ord("4")]) + struct.pack("<Q", 7_000_000) + b"engine failure")


def ulog_parameter(name: str, value: float) -> bytes:
    key = f"float {name}".encode()
    return message("P", bytes([len(key)]) + key + struct.pack("<f", value))


POSITION = [("f", "x"), ("f", "y"), ("f", "z"), ("f", "vx"), ("f", "vy"), ("f", "vz"), ("?", "xy_valid")]
STATUS = [("B", "nav_state"), ("B", "arming_state")]
ATTITUDE = [("f", "q[0]"), ("f", "q[1]"), ("f", "q[2]"), ("f", "q[3]")]


def px4_flight(tenths: int = 200) -> bytes:
    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(tenths + 1):
        at = 5 + tenth / 10
        rows.append(("vehicle_local_position", at, (3.0, 4.0 + tenth / 10, -10.0, 0.0, 1.0, 0.0, True)))
        yaw = math.radians(350 + tenth / 10)
        rows.append(("vehicle_attitude", at, (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))))
    statuses = ((0.0, (17, 2)), (tenths / 40, (3, 2)), (3 * tenths / 40, (4, 2)))
    rows += [("vehicle_status", 5.0 + after_s, status) for after_s, status in statuses]
    topics = {"vehicle_local_position": POSITION, "vehicle_status": STATUS, "vehicle_attitude": ATTITUDE}
    return ulog(topics, rows)


def dataflash(kinds: dict[str, tuple[str, str]], rows: Sequence[tuple[str, tuple[Any, ...]]]) -> bytes:
    """An ArduPilot log: per message its format letters and column names, and rows."""
    codes = {letter: letter for letter in "QfdBHiIh"} | {"M": "b", "N": "16s", "Z": "64s"}
    fmt = "BBnNZ"
    data = b""
    numbers = {name: 10 + index for index, name in enumerate(kinds)}

    def describe(number: int, length: int, name: str, letters: str, columns: str) -> bytes:
        body = (name.encode().ljust(4, b"\0"), letters.encode().ljust(16, b"\0"), columns.encode().ljust(64, b"\0"))
        return b"\xa3\x95\x80" + struct.pack("<BB", number, length) + b"".join(body)

    data += describe(0x80, 89, "FMT", fmt, "Type,Length,Name,Format,Columns")
    for name, (letters, columns) in kinds.items():
        size = 3 + struct.calcsize("<" + "".join(codes[letter] for letter in letters))
        data += describe(numbers[name], size, name, letters, columns)
    for name, values in rows:
        packed = struct.pack("<" + "".join(codes[letter] for letter in kinds[name][0]), *values)
        data += b"\xa3\x95" + bytes([numbers[name]]) + packed
    return data


KINDS = {
    "XKF1": ("QBffffff", "TimeUS,C,PN,PE,PD,VN,VE,VD"),
    "MODE": ("QBBB", "TimeUS,Mode,ModeNum,Rsn"),
    "EV": ("QB", "TimeUS,Id"),
    "ERR": ("QBB", "TimeUS,Subsys,ECode"),
}


def ardupilot_flight(
    kinds: dict[str, tuple[str, str]] = KINDS, tenths: int = 100, more: Sequence[tuple[str, tuple[float, ...]]] = ()
) -> bytes:
    rows: list[tuple[str, tuple[float, ...]]] = [("MODE", (1_000_000, 4, 4, 1)), ("EV", (1_000_000, 10))]
    for tenth in range(tenths + 1):
        at = 1_000_000 + tenth * 100_000
        rows.append(("XKF1", (at, 0, 0.1 * tenth, 0.0, -5.0 - 0.1 * tenth, 1.0, 0.0, -1.0)))
        rows.append(("XKF1", (at, 1, 99.0, 99.0, 99.0, 0.0, 0.0, 0.0)))
        if tenth == tenths // 2:
            rows += [("MODE", (at, 6, 6, 1)), ("ERR", (at, 5, 1)), ("EV", (at, 51))]
    return dataflash(kinds, [*rows, *more])
