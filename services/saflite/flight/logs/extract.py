"""Extracts of PX4 logs (`.csv`, a row about every half second) as traces: for logs whose bytes are not at hand.

Columns are PX4's words: `t_s`, then any of `x y z vx vy vz` (north, east, down; m, m/s), `roll_deg pitch_deg yaw_deg`,
`rollspeed pitchspeed yawspeed` (rad/s), `nav_state`, `arming_state`, `landed`, `fix_type`, `satellites_used`, `thrust`.
Empty fields are gaps. A file `summary.csv` beside may hold the texts of the autopilot, columns `file` and
`messages_warn_or_worse`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.outside import begins_with, parse_csv, parse_table, read_text
from saflite.contract.signals import MODES
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.ulog import ARMED, FIX_3D, MODE_NAMES, OTHER_MODE

TIME, SUMMARY = "t_s", "summary.csv"
_PLAIN = {
    "x": ("x_m", 1.0),
    "y": ("y_m", 1.0),
    "z": ("altitude_m", -1.0),
    "vx": ("vx_mps", 1.0),
    "vy": ("vy_mps", 1.0),
    "vz": ("climb_mps", -1.0),
    "roll_deg": ("roll_deg", 1.0),
    "pitch_deg": ("pitch_deg", 1.0),
    "yaw_deg": ("yaw_deg", 1.0),
    "rollspeed": ("roll_rate_dps", math.degrees(1.0)),
    "pitchspeed": ("pitch_rate_dps", math.degrees(1.0)),
    "yawspeed": ("yaw_rate_dps", math.degrees(1.0)),
    "landed": ("landed", 1.0),
    "satellites_used": ("gps_satellites", 1.0),
    "thrust": ("throttle", 1.0),
}

Column = NDArray[np.float64]


def is_extract(path: Path) -> bool:
    """Return whether a `.csv` file begins as an extract does; other tables in a folder of logs are no logs."""
    start = begins_with(path, 4096)
    if start is None:
        return True  # to be refused with the reason when it is read
    return start.decode("utf-8-sig", "replace").partition("\n")[0].split(",")[0].strip() == TIME


def read_extract(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in an extract.

    Raises:
        Refused: another layout, a field that is no number, or no position (if `placed`).
    """
    rows = parse_csv(read_text(path, "log extract"), "log extract", str(path))
    heads = [word.strip() for word in rows[0]] if rows else []
    if not heads or heads[0] != TIME:
        raise Refused(
            "log extract", where=str(path), expected=f"columns {TIME}, x, y, z, ...", got=", ".join(heads[:6])
        )
    values = np.array([_numbers(row, heads, f"{path} line {number}") for number, row in enumerate(rows[1:], start=2)])
    values = values.reshape(-1, len(heads))
    read = {name: values[:, place] for place, name in enumerate(heads)}
    columns = Columns()
    for name, (signal, scale) in _PLAIN.items():
        if name in read:
            columns.add(signal, read[TIME], read[name] * scale)
    _states(read, columns)
    columns.messages = [(0.0, text, "warning") for text in _texts(path)]
    return columns.trace("log extract", str(path), placed=placed)


def _numbers(row: Sequence[str], heads: Sequence[str], where: str) -> list[float]:
    if len(row) != len(heads):
        raise Refused("log extract", where=where, expected=f"{len(heads)} fields", got=len(row))
    try:
        return [float(field) if field.strip() else math.nan for field in row]
    except ValueError as fault:
        raise Refused("log extract", where=where, expected="numbers or empty fields", got=str(fault)) from fault


def _states(read: dict[str, Column], columns: Columns) -> None:
    times = read[TIME]
    if "nav_state" in read:
        columns.add("mode", times, [_mode(state) for state in read["nav_state"]])
    for name, signal, least in (("arming_state", "armed", ARMED), ("fix_type", "gps_ok", FIX_3D)):
        if name in read:
            given = read[name]
            met = given == least if signal == "armed" else given >= least
            columns.add(signal, times, np.where(np.isnan(given), np.nan, met))


def _mode(state: float) -> float:
    if math.isnan(state):
        return math.nan
    return float(MODES[MODE_NAMES[int(state)]]) if int(state) in MODE_NAMES else OTHER_MODE


def _texts(path: Path) -> list[str]:
    """Return the texts a summary beside the extract tells of; their times are not known."""
    summary = path.parent / SUMMARY
    if not summary.is_file():
        return []
    rows = parse_table(read_text(summary, "summary of extracts"), "summary of extracts", str(summary))
    texts = [row.get("messages_warn_or_worse") or "" for row in rows if row.get("file") == path.stem]
    return [part.strip() for text in texts for part in text.split(" | ") if part.strip()]
