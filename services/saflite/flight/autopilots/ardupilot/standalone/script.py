"""@DESCRIPTION@"""

# A template: `export.py` beside it puts the facts of a finding in. What it makes needs pymavlink and nothing else.

from __future__ import annotations

import argparse
import csv
import json
import socket
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from pymavlink import mavutil

FACTS: dict[str, Any] = json.loads(r"""{"@FACTS@": 0}""")
LINK_PORT, RADIO_PORT = 5760, 5501
READY_S, CLIMB_S, ANSWER_S = 120.0, 90.0, 5.0  # of the autopilot's own time
SETTLE_S = 30.0  # rules go by how long ago a take-off was ordered when a hold begins
SILENT_S = 30.0  # of wall time
ARM, TAKEOFF, SET_MODE, START_MISSION, SET_INTERVAL = 400, 22, 176, 300, 511
STREAMED = {"LOCAL_POSITION_NED": 32, "SYS_STATUS": 1, "EKF_STATUS_REPORT": 193, "ATTITUDE": 30}
COLUMNS = (
    *("time_s", "mode", "north_m", "east_m", "altitude_m"),
    *("north_mps", "east_mps", "climb_mps", "roll_rad", "pitch_rad"),
)
PREARM, EKF_NEEDED, ARMED = 1 << 28, 63, 128


class Died(Exception):
    """The autopilot is gone or silent."""


class Vehicle:
    """The autopilot on its own physics, its clock, its link and its radio."""

    def __init__(self, binary: Path, folder: Path, speedup: float) -> None:
        (folder / "start.parm").write_text(parm())
        place = "{:.7f},{:.7f},{:.2f},{:.1f}".format(*FACTS["home"])
        words = [str(binary), "--model", "x", "--speedup", f"{speedup:g}", "--wipe", "--defaults", "start.parm"]
        self.console = (folder / "console.txt").open("wb")
        self.process = subprocess.Popen([*words, "--home", place], cwd=folder, stdout=self.console, stderr=self.console)
        self.radio = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.pulses = [1500, 1500, 1000, 1500, *[1500] * 12]
        self.now_s = self.zero_s = self._beat_s = 0.0
        self.latest: dict[str, Any] = {}
        self.rows: list[list[Any]] = []
        self.link: Any = mavutil.mavlink_connection(f"tcp:127.0.0.1:{LINK_PORT}", retries=60)

    def poll(self) -> Any:
        """Return the next message, None for one that says nothing; keeps radio and heartbeat going."""
        self.radio.sendto(struct.pack("<16H", *self.pulses), ("127.0.0.1", RADIO_PORT))
        message = self.link.recv_match(blocking=True, timeout=SILENT_S)
        if message is None or self.process.poll() is not None:
            raise Died
        kind = message.get_type()
        if message.get_srcSystem() != 1 or kind == "BAD_DATA":
            return None
        self.latest[kind] = message
        if kind == "LOCAL_POSITION_NED":
            self._tick(message)
        elif kind == "STATUSTEXT":
            self.tell(message.text)
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self._mode(message)
        return message

    def _tick(self, message: Any) -> None:
        self.now_s = message.time_boot_ms * 1e-3
        if self.now_s - self._beat_s >= 1.0:
            self._beat_s = self.now_s
            self.link.mav.heartbeat_send(6, 8, 0, 0, 0)
        beat, lean = self.latest.get("HEARTBEAT"), self.latest.get("ATTITUDE")
        where = [round(value, 3) for value in (message.x, message.y, -message.z, message.vx, message.vy, -message.vz)]
        angles = [0.0, 0.0] if lean is None else [round(lean.roll, 4), round(lean.pitch, 4)]
        self.rows.append([round(self.now_s - self.zero_s, 3), beat.custom_mode if beat else -1, *where, *angles])

    def _mode(self, message: Any) -> None:
        state = (message.custom_mode, message.base_mode & ARMED)
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

    def order(self, number: int, *values: float) -> None:
        """Give a command and wait for its answer."""
        self.link.mav.command_long_send(1, 1, number, 0, *[*values, *[0.0] * 7][:7])
        self.hear_answer(number)

    def order_place(self, fields: list[Any]) -> None:
        """Give a command with a place, from the frame of its height on, and wait for its answer."""
        self.link.mav.command_int_send(1, 1, *fields)
        self.hear_answer(fields[1])

    def hear_answer(self, number: int) -> None:
        """Wait for the answer to a command and tell it."""
        self.latest.pop("COMMAND_ACK", None)
        if self.wait(lambda: "COMMAND_ACK" in self.latest, ANSWER_S):
            self.tell(f"command {number}: result {self.latest['COMMAND_ACK'].result}")

    @property
    def ready(self) -> bool:
        """Whether it may be armed and knows its place."""
        health, estimate = self.latest.get("SYS_STATUS"), self.latest.get("EKF_STATUS_REPORT")
        checked = health is not None and health.onboard_control_sensors_health & PREARM
        return bool(checked and estimate is not None and estimate.flags & EKF_NEEDED == EKF_NEEDED)

    @property
    def height_m(self) -> float:
        """Height above home by its own estimate."""
        told = self.latest.get("LOCAL_POSITION_NED")
        return 0.0 if told is None else -told.z

    def end(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        self.console.close()
        self.radio.close()


def say(words: str) -> None:
    """Print a line at once."""
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


def parm() -> str:
    """Return the parameters as a `.parm` file."""
    return "".join(f"{name} {value:.9g}\n" for name, value in FACTS["parameters"].items())


def start(vehicle: Vehicle) -> None:
    """Reach the start state."""
    vehicle.link.wait_heartbeat()
    for number in STREAMED.values():
        vehicle.link.mav.command_long_send(1, 1, SET_INTERVAL, 0, number, 40_000, 0, 0, 0, 0, 0)
    vehicle.poll()
    if not vehicle.wait(lambda: vehicle.ready, READY_S):
        raise SystemExit("the autopilot did not get ready: see console.txt")
    if FACTS["items"]:
        upload(vehicle)
    if not FACTS["armed"] and not FACTS["items"]:
        vehicle.order(SET_MODE, 1, FACTS["mode"])
        return
    flies = FACTS["items"] or FACTS["altitude_m"] > 0
    vehicle.order(SET_MODE, 1, 4 if flies else FACTS["mode"])
    vehicle.order(ARM, 1)
    if FACTS["items"]:
        vehicle.pulses[2] = 1500
        vehicle.order(START_MISSION)
    elif flies:
        vehicle.order(TAKEOFF, 0, 0, 0, 0, 0, 0, FACTS["altitude_m"])
        vehicle.wait(lambda: abs(vehicle.height_m - FACTS["altitude_m"]) < 0.5, CLIMB_S)
        vehicle.pulses[2] = 1500
        vehicle.wait(lambda: False, SETTLE_S)
        vehicle.order(SET_MODE, 1, FACTS["mode"])


def upload(vehicle: Vehicle) -> None:
    """Send the mission."""
    items, asked = FACTS["items"], -1
    vehicle.link.mav.mission_count_send(1, 1, len(items), 0)
    vehicle.latest.pop("MISSION_ACK", None)
    while "MISSION_ACK" not in vehicle.latest:
        message = vehicle.poll()
        if message is not None and message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            asked = message.seq
            frame, command, current, more, *numbers, x, y, z = items[asked]
            fields = (asked, int(frame), int(command), int(current), int(more), *numbers, int(x), int(y), z)
            vehicle.link.mav.mission_item_int_send(1, 1, *fields, 0)


def give(vehicle: Vehicle, what: dict[str, Any]) -> None:
    """Give one input."""
    vehicle.tell(f"given: {what['kind']} {what['name']} {what['values']}")
    if what["kind"] == "stick":
        vehicle.pulses[int(what["name"][2:]) - 1] = round(min(2200, max(800, what["values"][0])))
    elif what["kind"] in ("parameter", "sensor_fault"):
        value = what["values"][0] if what["values"] else 1.0
        vehicle.link.mav.param_set_send(1, 1, what["name"].encode(), value, what["number"])
    elif "placed" in what:
        vehicle.order_place(what["placed"])
    else:
        vehicle.order(what["number"], *what["values"])


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
    parser.add_argument("binary", type=Path, help="ArduCopter built for SITL")
    parser.add_argument("--folder", type=Path, help="where parameters, console, track and log go (a new one)")
    parser.add_argument("--speedup", type=float, default=5.0)
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="finding-"))
    folder.mkdir(parents=True, exist_ok=True)
    vehicle = Vehicle(options.binary.resolve(), folder, options.speedup)
    died = False
    try:
        fly(vehicle)
    except (Died, OSError):
        died = True
        vehicle.tell(f"the autopilot is gone: exit code {vehicle.process.poll()}")
    finally:
        vehicle.end()
    with (folder / "track.csv").open("w", newline="") as file:
        names = [
            "time_s",
            "mode",
            "north_m",
            "east_m",
            "altitude_m",
            "v_north",
            "v_east",
            "climb",
            "roll_rad",
            "pitch_rad",
        ]
        csv.writer(file).writerows([names, *vehicle.rows])
    logs = sorted((folder / "logs").glob("*.BIN"))
    say(f"in {folder}: start.parm, console.txt, track.csv")
    say(f"DataFlash log: {logs[-1] if logs else 'none'}")
    say(f"The rule: {FACTS['title']}; broken in the farm from {FACTS['from_s']:.1f} s on. The farm judges the log by")
    say(f"saflite judge {logs[-1] if logs else 'LOG'} --policy {FACTS['policy']}")
    return 0 if died == FACTS["died"] else 1


if __name__ == "__main__":
    sys.exit(main())
