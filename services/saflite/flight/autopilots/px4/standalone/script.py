"""@DESCRIPTION@"""

# A template: `export.py` beside it puts the facts of a finding in. What it makes needs pymavlink and nothing else.

from __future__ import annotations

import argparse
import csv
import json
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from pymavlink import mavutil

FACTS: dict[str, Any] = json.loads(r"""{"@FACTS@": 0}""")
LINK = "udpin:127.0.0.1:14550"
READY_S, CLIMB_S, SETTLE_S, ANSWER_S = 60.0, 60.0, 30.0, 3.0  # of the autopilot's own time
BETWEEN_S, ALTCTL = 1.0, (2, 0)  # rules go by how long ago a take-off was ordered when a hold begins
BOOT_S, SILENT_S = 120.0, 30.0  # of wall time
ARM, TAKEOFF, SET_MODE, SET_INTERVAL = 400, 22, 176, 511
STREAMED = {"LOCAL_POSITION_NED": 32, "SYS_STATUS": 1, "GLOBAL_POSITION_INT": 33, "ATTITUDE": 30}
COLUMNS = (
    *("time_s", "mode", "north_m", "east_m", "altitude_m"),
    *("north_mps", "east_mps", "climb_mps", "roll_rad", "pitch_rad"),
)
PREARM, ARMED, REAL32, NAN = 1 << 28, 128, 9, float("nan")


class Died(Exception):
    """The autopilot is gone or silent."""


class Vehicle:
    """The autopilot on its own physics (SIH), its clock, its link and the pilot's sticks."""

    def __init__(self, binary: Path, folder: Path, speed: float) -> None:
        given = {f"PX4_PARAM_{name}": text for name, text in FACTS["parameters"].items()}
        place = dict(zip(("PX4_HOME_LAT", "PX4_HOME_LON", "PX4_HOME_ALT"), map(str, FACTS["home"]), strict=True))
        model = {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SIM_SPEED_FACTOR": f"{speed:g}"}
        words = [str(binary), "-d", "-w", str(folder), str(binary.parent.parent / "etc")]
        told = {"PATH": os.defpath, **model, **place, **given}
        self.link: Any = mavutil.mavlink_connection(LINK, source_system=255)
        self.console = (folder / "console.txt").open("wb")
        self.process = subprocess.Popen(words, cwd=folder, env=told, stdout=self.console, stderr=self.console)
        self.pulses, self.silent = [1500, 1500, 1000, 1500], False
        self.now_s = self.zero_s = self._beat_s = 0.0
        self.latest: dict[str, Any] = {}
        self.rows: list[list[Any]] = []

    def poll(self) -> Any:
        """Return the next message, None for one that says nothing; keeps sticks and heartbeat going."""
        message = self.link.recv_match(blocking=True, timeout=SILENT_S)
        if message is None or self.process.poll() is not None:
            raise Died
        kind = message.get_type()
        if message.get_srcSystem() != 1 or message.get_srcComponent() != 1 or kind == "BAD_DATA":
            return None
        self.latest[kind] = message
        if kind == "LOCAL_POSITION_NED":
            self._tick(message)
        elif kind == "STATUSTEXT":
            self.tell(message.text)
        elif kind == "HEARTBEAT":
            self._mode(message)
        return message

    def _tick(self, message: Any) -> None:
        self.now_s = message.time_boot_ms * 1e-3
        if self.now_s - self._beat_s >= 0.5:
            self._beat_s = self.now_s
            self.link.mav.heartbeat_send(6, 8, 0, 0, 0)
        if not self.silent:
            roll, pitch, throttle, yaw = (2 * (min(2000, max(1000, pulse)) - 1500) for pulse in self.pulses)
            self.link.mav.manual_control_send(1, -pitch, roll, 500 + throttle // 2, yaw, 0)
        beat, lean = self.latest.get("HEARTBEAT"), self.latest.get("ATTITUDE")
        where = [round(value, 3) for value in (message.x, message.y, -message.z, message.vx, message.vy, -message.vz)]
        angles = [0.0, 0.0] if lean is None else [round(lean.roll, 4), round(lean.pitch, 4)]
        self.rows.append([round(self.now_s - self.zero_s, 3), "-" if beat is None else mode_of(beat), *where, *angles])

    def _mode(self, message: Any) -> None:
        state = (mode_of(message), message.base_mode & ARMED)
        if state != getattr(self, "_state", None):
            self._state = state
            self.tell(f"mode {state[0]}, {'armed' if state[1] else 'disarmed'}")

    def tell(self, words: str) -> None:
        """Print what happened, with the time since the start state."""
        say(f"{self.now_s - self.zero_s:9.2f} s  {words}")

    def wait(self, good: Any, within_s: float) -> bool:
        """Poll until it is good; return whether it came in time."""
        end_s = self.now_s + within_s
        while self.now_s < end_s:
            self.poll()
            if good():
                return True
        return False

    def order(self, number: int, *values: float) -> bool:
        """Give a command and wait for its answer; return whether it was accepted."""
        self.latest.pop("COMMAND_ACK", None)
        self.link.mav.command_long_send(1, 1, number, 0, *[*values, *[0.0] * 7][:7])
        if not self.wait(lambda: "COMMAND_ACK" in self.latest, ANSWER_S):
            self.tell(f"command {number}: no answer")
            return False
        result = self.latest["COMMAND_ACK"].result
        self.tell(f"command {number}: result {result}")
        return bool(result == 0)

    @property
    def ready(self) -> bool:
        """Whether it may be armed and knows its place."""
        health = self.latest.get("SYS_STATUS")
        checked = health is not None and health.onboard_control_sensors_health & PREARM
        return bool(checked and "GLOBAL_POSITION_INT" in self.latest and "HOME_POSITION" in self.latest)

    @property
    def height_m(self) -> float:
        """Height above where it started, by its own estimate."""
        told = self.latest.get("LOCAL_POSITION_NED")
        return 0.0 if told is None else -told.z

    def end(self) -> None:
        """End it."""
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.console.close()


def say(words: str) -> None:
    """Print a line at once."""
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


def mode_of(beat: Any) -> str:
    """Return main and sub mode."""
    return f"{beat.custom_mode >> 16 & 0xFF}.{beat.custom_mode >> 24}"


def start(vehicle: Vehicle) -> None:
    """Reach the start state."""
    vehicle.link.wait_heartbeat(timeout=BOOT_S)
    for number in STREAMED.values():
        vehicle.link.mav.command_long_send(1, 1, SET_INTERVAL, 0, number, 20_000, 0, 0, 0, 0, 0)
    vehicle.poll()
    if not vehicle.wait(lambda: vehicle.ready, READY_S):
        raise SystemExit("the autopilot did not get ready: see console.txt")
    flies = bool(FACTS["items"]) or (FACTS["armed"] and FACTS["altitude_m"] > 0)
    if flies:
        vehicle.pulses[2] = 1500
        vehicle.wait(lambda: False, 1.0)
    if FACTS["items"]:
        upload(vehicle)
        good = vehicle.order(SET_MODE, 1, *FACTS["mode"]) and vehicle.order(ARM, 1)
    elif flies:
        above_sea_m = vehicle.latest["GLOBAL_POSITION_INT"].alt * 1e-3 + FACTS["altitude_m"]
        good = vehicle.order(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, above_sea_m) and vehicle.order(ARM, 1)
        good = good and vehicle.wait(lambda: abs(vehicle.height_m - FACTS["altitude_m"]) < 0.7, CLIMB_S)
        vehicle.wait(lambda: False, SETTLE_S)
        good = good and vehicle.order(SET_MODE, 1, *ALTCTL)  # out of the hold in which a take-off ends
        vehicle.wait(lambda: False, BETWEEN_S)
        good = good and vehicle.order(SET_MODE, 1, *FACTS["mode"])
    else:
        if FACTS["armed"]:  # not in every mode
            vehicle.order(SET_MODE, 1, *FACTS["arms_in"])
        good = (not FACTS["armed"] or vehicle.order(ARM, 1)) and vehicle.order(SET_MODE, 1, *FACTS["mode"])
    if not good:
        raise SystemExit("the start state was not reached: see above")


def upload(vehicle: Vehicle) -> None:
    """Send the mission."""
    items = FACTS["items"]
    vehicle.link.mav.mission_count_send(1, 1, len(items), 0)
    vehicle.latest.pop("MISSION_ACK", None)
    while "MISSION_ACK" not in vehicle.latest:
        message = vehicle.poll()
        if message is not None and message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            frame, command, current, more, *numbers, x, y, z = (
                NAN if one is None else one for one in items[message.seq]
            )
            fields = (message.seq, int(frame), int(command), int(current), int(more), *numbers, int(x), int(y), z)
            vehicle.link.mav.mission_item_int_send(1, 1, *fields, 0)


def give(vehicle: Vehicle, what: dict[str, Any]) -> None:
    """Give one input."""
    vehicle.tell(f"given: {what['kind']} {what['name']} {what['values']}")
    if what["kind"] == "stick":
        vehicle.pulses[int(what["name"][2:]) - 1] = round(what["values"][0])
    elif what["name"] == "radio_loss":
        vehicle.silent = bool(what["values"][0])
    elif what["kind"] == "parameter":
        value, kind = what["values"][0], what["number"]
        if kind != REAL32:  # whole numbers travel as the bits of a float
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        vehicle.link.mav.param_set_send(1, 1, what["name"].encode(), value, kind)
    else:
        vehicle.order(what["number"], *(NAN if value is None else value for value in what["values"]))


def fly(vehicle: Vehicle) -> None:
    """Fly the finding's inputs from the start state to its end."""
    start(vehicle)
    vehicle.zero_s = vehicle.now_s
    vehicle.rows.clear()
    vehicle.tell("start state")
    for what in FACTS["inputs"]:
        vehicle.wait(lambda what=what: vehicle.now_s - vehicle.zero_s >= what["at_s"], 1e9)
        give(vehicle, what)
    vehicle.wait(lambda: False, FACTS["limit_s"] - (vehicle.now_s - vehicle.zero_s))


def main() -> int:
    """Fly it; return 0 when it was flown to the end (or died, where that is the finding)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path, help="bin/px4 of a build of PX4 for its simulator (px4_sitl)")
    parser.add_argument("--folder", type=Path, help="where console, track and log go (a new one)")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time")
    options = parser.parse_args()
    folder = (options.folder or Path(tempfile.mkdtemp(prefix="finding-"))).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    vehicle = Vehicle(options.binary.resolve(), folder, options.speed)
    died = False
    try:
        fly(vehicle)
    except (Died, OSError):
        died = True
        vehicle.tell(f"the autopilot is gone: exit code {vehicle.process.poll()}")
    finally:
        vehicle.end()
    with (folder / "track.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *vehicle.rows])
    logs = sorted(folder.rglob("*.ulg"))
    say(f"in {folder}: console.txt, track.csv")
    say(f"ULog: {logs[-1] if logs else 'none'}")
    say(f"The rule: {FACTS['title']}; broken in the farm from {FACTS['from_s']:.1f} s on. The farm judges the log by")
    say(f"saflite judge {logs[-1] if logs else 'LOG'} --policy {FACTS['policy']}")
    return 0 if died == FACTS["died"] else 1


if __name__ == "__main__":
    sys.exit(main())
