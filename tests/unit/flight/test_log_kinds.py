"""What is no log to judge is refused by what it is: telemetry, DataFlash as text, a PX4 of before ULog, a plane."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from log_bytes import dataflash

from saflite.contract.errors import Refused
from saflite.flight.logs.files import read_log

TEXT = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\r\nMSG, ArduCopter V3.2\r\n"
TELEMETRY = struct.pack(">Q", 1_700_000_000_000_000)
SDLOG2 = {"LPOS": ("fff", "X,Y,Z"), "STAT": ("BB", "MainState,NavState"), "TIME": ("Q", "StartTime")}
PLANE = {"PARM": ("Nf", "Name,Value")}


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("flight.log", TEXT, "as text"),
        ("flight.bin", b"\r\n" + TEXT, "as text"),
        ("flight.log", b"1\r\nArduCopter V3.1\r\nFree RAM: 2000\r\n" + TEXT, "as text"),
        ("flight.tlog", TELEMETRY + b"\xfe\x09", "telemetry"),
        ("flight.rlog", TELEMETRY + b"\xfd\x09", "telemetry"),
        ("flight.bin", dataflash(SDLOG2, [("LPOS", (0.0, 0.0, 0.0)), ("STAT", (1, 2)), ("TIME", (5,))]), "sdlog2"),
        ("flight.px4log", dataflash(SDLOG2, [("TIME", (n,)) for n in range(20)]), "sdlog2"),
        ("flight.bin", dataflash(PLANE, [("PARM", (b"ARSPD_FBW_MIN", 9.0))]), "ARSPD_FBW_MIN"),
    ],
)
def test_a_file_of_another_kind_is_refused_by_what_it_is(name: str, data: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(Refused, match=said):
        read_log(path)
