"""ArduPilot flight logs (`.bin`) as traces, through pymavlink: estimate, attitude, modes, events, failsafes, sticks.

Messages and fields are those of ArduPilot's LogStructure; events and errors are read by `dataflash_events.py`.
What one release logs in another message than the next is read from either; what a log does not hold is not told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import Stimulus
from saflite.flight.logs import batteries, dataflash_events
from saflite.flight.logs.commands import REFUSALS, command
from saflite.flight.logs.dataflash_rows import FIX_3D, Rows, load, lowest, points, settings_told
from saflite.flight.logs.flight_log import (
    NO_ORDERS,
    UNTOLD,
    FlightLog,
    Points,
    begins_in_flight,
    changed_by_hand,
    told_of,
    within,
)
from saflite.flight.logs.home import Place, add_home, homes_of_ardupilot
from saflite.flight.logs.leaps import add_leaps_of_ardupilot
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.settings import ARDUPILOT, SOURCE_SET, add_settings, sources
from saflite.flight.logs.targets import targets_of_ardupilot
from saflite.flight.logs.terrain import forget_by_terrain
from saflite.flight.mavlink.items import ORDERED_PLACES
from saflite.flight.mission import to_local

_FIELDS: dict[str, dict[str, str]] = {
    "RATE": {"R": "roll_rate_dps", "P": "pitch_rate_dps", "Y": "yaw_rate_dps"},
    "GPS": {"NSats": "gps_satellites"},
    "BARO": {"Alt": "baro_altitude_m"},
    "CTUN": {"DAlt": "altitude_target_m"},
    "MISE": {"CNum": "mission_item", "CTot": "mission_count"},
}
_ATTITUDES = ("ATT", "AHR2", "XKF1", "NKF1", "EKF1")
_LEAN = {"Roll": "roll_deg", "Pitch": "pitch_deg", "Yaw": "yaw_deg"}
_OF_COMMANDS = (
    "command_quiet_s",
    "divert_order_s",
    "place_order_s",
    "ordered_x_m",
    "ordered_y_m",
    "ordered_altitude_m",
    "yaw_order_s",
    "ordered_yaw_way",
    "pause_order_s",
    "start_order_s",
    "climb_order_s",
    "height_order_s",
    "ordered_home_m",
)
_SOURCES = {
    **dict.fromkeys(("x_m", "y_m"), "XKF1, NKF1 or POS"),
    **dict.fromkeys(("altitude_m",), "XKF1, NKF1, POS or CTUN.Alt"),
    **dict.fromkeys(("vx_mps", "vy_mps"), "XKF1 or NKF1"),
    "climb_mps": "XKF1, NKF1 or CTUN.CRt",
    **{signal: f"{kind}.{field}" for kind, fields in _FIELDS.items() for field, signal in fields.items()},
    **{signal: f"ATT.{field} or AHR2.{field}" for field, signal in _LEAN.items()},
    "baro_altitude_m": "BARO.Alt, CTUN.BAlt or CTUN.BarAlt",
    "home_distance_m": "ORGN, else from where the log begins",
    "mode": "MODE.ModeNum or MODE.Mode",
    "throttle": "CTUN.ThO or CTUN.ThrOut",
    "battery_v": "BAT.Volt or CURR.Volt",
    **{f"rc{number}_pwm": "RCIN" for number in range(1, 5)},
    **dict.fromkeys(("failsafe_radio", "failsafe_battery", "failsafe_gps", "failsafe_fence", "crashed"), "EV and ERR"),
    **dict.fromkeys(("armed", "landed", "taken_off", "above_ground_m"), "EV or ARM"),
    **dict.fromkeys(("chute_released", "rc_present"), "EV"),
    "stop_ordered": "EV, ARM or MAVC",
    **dict.fromkeys(("circle_radius_m", "circle_rate_dps"), "no message: what CIRCLE aims at is not logged"),
    **dict.fromkeys(_OF_COMMANDS, "MAVC"),
    **NO_ORDERS,
    "takeoff": "MISE",
    "gps_ok": "GPS.Status",
    "baro_ok": "BARO",
    **sources(ARDUPILOT),
}
_SWITCHES: dict[float, tuple[str, float]] = {
    41: ("FENCE_ENABLE", 1.0),
    42: ("FENCE_ENABLE", 0.0),
    85: (SOURCE_SET, 1.0),
    86: (SOURCE_SET, 2.0),
    87: (SOURCE_SET, 3.0),
}
"""Events that say what was switched as a setting is."""
_NAV_TAKEOFF = 22
_THROTTLE = 3
_MODE = ("ModeNum", "Mode")
"""Of MODE; up to 3.2 the second alone. Both are the number."""
_FILTERS = {1.0: "EKF1", 2.0: "NKF1", 3.0: "XKF1"}
"""Of AHRS_EKF_TYPE; 1 is that of AHRS_EKF_USE, too."""
_CM_PER_M = 100.0
_OTHERS = ("ArduPlane", "ArduRover", "ArduSub", "Rover", "Blimp", "AntennaTracker", "APM:Plane", "APM:Rover")
_OF_OTHERS = ("ARSPD_FBW_MIN", "AIRSPEED_MIN", "CRUISE_SPEED", "PILOT_SPEED", "YAW_RANGE")
_OF_COPTERS = (
    *("WPNAV_SPEED", "PILOT_SPEED_UP", "PILOT_VELZ_MAX", "LAND_SPEED", "RTL_ALT"),
    *("LAND_SPD_MS", "RTL_ALT_M"),
)
_OF_OLD_PX4 = {"LPOS", "STAT", "TIME"}
_NO_HOME = "ORGN, without which a log that begins in the air does not tell places"


def read_dataflash(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in an ArduPilot log; raises as `read_dataflash_log` does."""
    return read_dataflash_log(path, placed=placed).trace


def read_dataflash_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what an ArduCopter log tells.

    Raises:
        Refused: the file is missing, is no dataflash log, is damaged, is not of a copter, or lacks a position (if
            `placed`) or all signals.
    """
    rows, formats, lost = load(path)
    if formats.keys() >= _OF_OLD_PX4 and "MODE" not in formats:
        got = "a log of an old PX4 (sdlog2); later ones write ULog (.ulg)"
        raise Refused("ArduPilot log", where=str(path), expected="an ArduCopter log", got=got)
    monitor = int(lowest(rows["BAT"] or rows["CURR"]))
    held = _first(batteries.of_monitor(settings_told(rows), monitor))
    _check_copter(rows, held, path)
    columns = Columns()
    frame = _position(rows, columns)
    _height(rows, formats, columns)
    _attitude(rows, columns)
    for kind, fields in _FIELDS.items():
        for field, signal in fields.items():
            _column(columns, signal, points(rows[kind], field))
    _column(columns, "mode", points(rows["MODE"], *_MODE))
    _column(columns, "throttle", points(rows["CTUN"], "ThO", "ThrOut"))
    _column(columns, "battery_v", points(rows["BAT"], *batteries.voltage_names(held)) or points(rows["CURR"], "Volt"))
    _column(columns, "gps_ok", [(at, float(status >= FIX_3D)) for at, status in points(rows["GPS"], "Status")])
    _sticks(rows, held, columns)
    dataflash_events.add(rows, formats, held, columns)
    _modes(rows, columns)
    add_leaps_of_ardupilot(rows, held, columns)
    changes = _parameters(rows, monitor, columns)
    targets = targets_of_ardupilot(rows, columns)
    forget_by_terrain(rows, columns)
    columns.messages = [(at, str(row.get("Message", "")), "info") for at, row in rows["MSG"]]
    homeless = () if placed else _from_home(rows, columns)
    add_home(columns, homes_of_ardupilot(rows, frame))
    trace = columns.trace("ArduPilot log", str(path), placed=placed)
    given = [*changes, *_commands(rows), *targets]
    stimuli = within(given, *columns.span("ArduPilot log", str(path), placed=placed))
    crashed = "crashed" in columns and bool((trace.array("crashed") == 1.0).any())
    logged = {kind for kind, told in rows.items() if told}
    told = {**told_of(_SOURCES, logged, columns), **dict.fromkeys(homeless, _NO_HOME)}
    untold = UNTOLD if "MAVC" in formats else UNTOLD.union(_OF_COMMANDS)
    return FlightLog(trace, stimuli, told, crashed, untold, lost)


def _check_copter(rows: Rows, held: Mapping[str, float], path: Path) -> None:
    """Refuse the log of another vehicle by what it says it is, or by its parameters: its modes have other numbers."""
    said = [str(row.get("Message", "")) for _, row in rows["MSG"]]
    other = next((text for text in said if text.startswith(_OTHERS)), None)
    if other is None and not any(name in held for name in _OF_COPTERS):
        other = next((f"one with the parameter {name}" for name in _OF_OTHERS if name in held), None)
    if other:
        raise Refused("ArduPilot log", where=str(path), expected="an ArduCopter log", got=other)


def _first(told: list[batteries.Told]) -> dict[str, float]:
    return {name: value for _, name, value in reversed(told)}


def _parameters(rows: Rows, monitor: int, columns: Columns) -> list[Stimulus]:
    """Add the settings in force and return what was changed in flight; the first value of each is what it was.

    A fence that was switched by order (DO_FENCE_ENABLE) is on or off whatever its parameter says, until that is set;
    the filter goes by the set of sources that was switched to last.
    """
    told, raised = settings_told(rows), columns.get("failsafe_battery")
    own = _as_sticks(batteries.of_monitor(told, monitor))
    switched = [(at, *_SWITCHES[number]) for at, number in points(rows["EV"], "Id") if number in _SWITCHES]
    unknown = batteries.unknown_from(list(zip(*raised, strict=True)) if raised else [], _first(told), monitor)
    first = _first(own)
    course = sorted([(0.0, SOURCE_SET, 1.0), *own, *switched, *unknown], key=lambda one: one[0])
    add_settings(columns, ARDUPILOT, first, _changed(course))
    if first and "chute_released" not in columns and not first.get("CHUTE_ENABLED"):
        columns.hold("chute_released", [0.0], [0.0])  # there is none on board
    return [
        Stimulus(at_s=at, kind="parameter", name=name, values=(value,))
        for at, name, value in _changed(told)
        if changed_by_hand(name)
    ]


def _changed(told: list[tuple[float, str, float]]) -> list[tuple[float, str, float]]:
    """Return what was told otherwise than before."""
    held: dict[str, float] = {}
    changes = []
    for at, name, value in told:
        if held.get(name, value) != value:
            changes.append((at, name, value))
        held[name] = value
    return changes


def _commands(rows: Rows) -> list[Stimulus]:
    """Return the commands that came over MAVLink (MAVC) and were not refused."""
    heard = ((at, row) for at, row in rows["MAVC"] if "Cmd" in row and row.get("Res") not in REFUSALS)
    made = (command(at, int(row["Cmd"]), _numbers(row)) for at, row in heard)
    return [one for one in made if one is not None]


def _numbers(row: Mapping[str, Any]) -> list[float]:
    """Return the seven numbers of a command; places lie in the log as in COMMAND_INT, degrees x 1e7."""
    size = 1e-7 if int(row["Cmd"]) in ORDERED_PLACES else 1.0
    sizes = {"P1": 1.0, "P2": 1.0, "P3": 1.0, "P4": 1.0, "X": size, "Y": size, "Z": 1.0}
    return [float(row.get(name, 0.0)) * one for name, one in sizes.items()]


def _column(columns: Columns, signal: str, found: Points) -> None:
    if found:
        times, values = zip(*found, strict=True)
        columns.add(signal, times, values)


def _position(rows: Rows, columns: Columns) -> Place | None:
    """Add the estimate of the filter that flies, of another that was logged, or POS.

    Return the place from which POS counts, None where it is the origin of a filter.
    """
    estimator = _filter(rows)
    if estimator is None:
        return _geographic(rows, columns)
    fields = {"PN": ("x_m", 1.0), "PE": ("y_m", 1.0), "PD": ("altitude_m", -1.0)}
    speeds = {"VN": ("vx_mps", 1.0), "VE": ("vy_mps", 1.0), "VD": ("climb_mps", -1.0)}
    for field, (signal, sign) in {**fields, **speeds}.items():
        _column(columns, signal, points(rows[estimator], field, scale=sign))
    return None


def _filter(rows: Rows) -> str | None:
    """Return the message of the filter that flies (AHRS_EKF_TYPE, up to 3.3 AHRS_EKF_USE), or of another one logged.

    None where what flies is no filter that logs itself: one that only runs along tells whatever it comes to.
    """
    held = _first(settings_told(rows))
    flies = held.get("AHRS_EKF_TYPE", held.get("AHRS_EKF_USE"))
    if flies is not None and flies not in _FILTERS:
        return None
    own = [] if flies is None else [_FILTERS[flies]]
    return next((kind for kind in (*own, "XKF1", "NKF1", "EKF1") if rows[kind]), None)


def _geographic(rows: Rows, columns: Columns) -> Place | None:
    """Fall back on the POS message: degrees and the height above home."""
    told = [row for row in rows["POS"] if {"Lat", "Lng"} <= row[1].keys()]
    if not told:
        return None
    home = told[0][1]
    local = [to_local(row["Lat"], row["Lng"], home["Lat"], home["Lng"]) for _, row in told]
    _column(columns, "x_m", [(at, x) for (at, _), (x, _) in zip(told, local, strict=True)])
    _column(columns, "y_m", [(at, y) for (at, _), (_, y) in zip(told, local, strict=True)])
    _column(columns, "altitude_m", points(told, "RelHomeAlt", "RelAlt", "Alt"))
    return home["Lat"], home["Lng"]


def _height(rows: Rows, formats: Mapping[str, str], columns: Columns) -> None:
    """Add height and climb of CTUN where no estimate tells them, and that the barometer answers.

    Its height is that of CTUN where it has no message of its own. CTUN.CRt is in cm/s where it is a whole number.
    """
    if "altitude_m" not in columns:
        _column(columns, "altitude_m", points(rows["CTUN"], "Alt"))
    if "climb_mps" not in columns and formats.get("CTUN", "").endswith("h"):
        _column(columns, "climb_mps", points(rows["CTUN"], "CRt", scale=1.0 / _CM_PER_M))
    if not points(rows["BARO"], "Alt"):
        _column(columns, "baro_altitude_m", points(rows["CTUN"], "BAlt", "BarAlt"))
    healthy = [(at, float(bool(row.get("H", row.get("Health", 1))))) for at, row in rows["BARO"]]
    _column(columns, "baro_ok", healthy)


def _attitude(rows: Rows, columns: Columns) -> None:
    """Add the lean by the first message that tells it; logs may leave ATT out."""
    kind = next((kind for kind in _ATTITUDES if points(rows[kind], "Roll")), None)
    for field, signal in _LEAN.items() if kind else ():
        _column(columns, signal, points(rows[str(kind)], field))


def _sticks(rows: Rows, held: Mapping[str, float], columns: Columns) -> None:
    """Add the sticks as fractions of their calibrated way: 1000 to 2000, 1500 where the trim is (RCn_MIN, RCMAP_*)."""
    for number, use in enumerate(("ROLL", "PITCH", "THROTTLE", "YAW"), start=1):
        channel = int(held.get(f"RCMAP_{use}", number))
        given = [(at, pwm) for at, pwm in points(rows["RCIN"], f"C{channel}") if pwm]
        _column(columns, f"rc{number}_pwm", [(at, _on_way(held, number, channel, pwm)) for at, pwm in given])


def _on_way(held: Mapping[str, float], number: int, channel: int, pwm: float) -> float:
    """Return where a pulse of a channel, which moves stick `number`, is on its calibrated way."""
    low, trim, high = (
        held.get(f"RC{channel}_{end}", usual) for end, usual in (("MIN", 1000.0), ("TRIM", 1500.0), ("MAX", 2000.0))
    )
    if number == _THROTTLE:
        trim = (low + high) / 2
    if not low < trim < high:
        low, trim, high = 1000.0, 1500.0, 2000.0
    share = (pwm - trim) / (high - trim if pwm > trim else trim - low)
    return 1500.0 - 500.0 * share if _is_reversed(held, channel) else 1500.0 + 500.0 * share


def _is_reversed(held: Mapping[str, float], channel: int) -> bool:
    return held.get(f"RC{channel}_REVERSED", 0.0) == 1.0 or held.get(f"RC{channel}_REV", 1.0) < 0


def _as_sticks(told: list[batteries.Told]) -> list[batteries.Told]:
    """Return settings with the limit of the throttle's pulse as its stick is told; not known where that is reversed."""
    held = _first(told)
    channel = int(held.get("RCMAP_THROTTLE", _THROTTLE))

    def way(pwm: float) -> float:
        return math.nan if _is_reversed(held, channel) else _on_way(held, _THROTTLE, channel, pwm)

    return [(at, name, way(value) if name == "FS_THR_VALUE" else value) for at, name, value in told]


def _modes(rows: Rows, columns: Columns) -> None:
    """Add what follows from modes and mission: take-off items, the end of a parachute's absence, aims of CIRCLE."""
    items = [(at, float(number == _NAV_TAKEOFF)) for at, number in points(rows["MISE"], "CId")]
    flown = {int(mode) for _, mode in points(rows["MODE"], *_MODE)}
    if items:
        columns.hold("takeoff", *zip((0.0, 0.0), *items, strict=True))
    if flown and MODES["CIRCLE"] not in flown:
        for name in ("circle_radius_m", "circle_rate_dps"):
            columns.hold(name, [0.0], [0.0])  # as the signal says of all other modes
    if flown and not flown & {MODES["AUTO"], MODES["GUIDED"]}:
        columns.hold("takeoff", [0.0], [0.0])


def _from_home(rows: Rows, columns: Columns) -> tuple[str, ...]:
    """Measure places of a log that begins in the air from home; return what is not known where home is not told.

    Heights count from home as the messages give them; the place of home is told beside that of the origin (ORGN).
    """
    if not begins_in_flight(columns):
        return ()
    columns.origin = {"altitude_m": 0.0, "baro_altitude_m": 0.0}
    told = {row["Type"]: row for _, row in reversed(rows["ORGN"]) if {"Type", "Lat", "Lng"} <= row.keys()}
    if not {0, 1} <= told.keys():
        return columns.drop("x_m", "y_m")
    x_m, y_m = to_local(told[1]["Lat"], told[1]["Lng"], told[0]["Lat"], told[0]["Lng"])
    columns.origin.update({"x_m": x_m, "y_m": y_m})
    return ()
