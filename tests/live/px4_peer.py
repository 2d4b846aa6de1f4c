"""The other end of the PX4 adapter's links, for tests without the real one: a program started as it would be.

It speaks the simulator's interface in lockstep and MAVLink, and hovers, climbs and lands by a few gains. It knows no
world: all it has are the sensors our side sends, or on physics of its own a mass that the throttles lift. Its
parameters `SIM_DIE`, `SIM_HANG`, `SIM_SPIN`, `SIM_SPARSE`, `SIM_CUT` and `SIM_NO_MISSION` make it end by a signal, fall
silent, set a thread of it spinning, answer one message of four, stop its motors, or take no mission. On physics of its
own it goes where set-points and sticks lead it.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import os
import re
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable
from hashlib import pbkdf2_hmac
from pathlib import Path
from typing import Any, NoReturn

from pymavlink.dialects.v20 import ardupilotmega as dialect

NAMES = {
    "RTL_RETURN_ALT": 60.0,
    "CP_DIST": -1.0,
    "RC_MAP_ROLL": 0.0,
    "GF_ACTION": 2.0,
    "SIM_DIE": 0.0,
    "SIM_HANG": 0.0,
    "SIM_SPIN": 0.0,
    "SIM_SPARSE": 0.0,
    "SIM_CUT": 0.0,
    "SIM_NEVER_READY": 0.0,
    "SIM_NO_MISSION": 0.0,
}
OWN_NAMES = {"SIH_VEHICLE_TYPE": 0.0, "SIM_GPS_USED": 10.0, "SIM_BARO_OFF_P": 0.0}
"""It has these where it flies on its own physics."""
WHOLE = {"RC_MAP_ROLL", "GF_ACTION", "SIH_VEHICLE_TYPE", "SIM_GPS_USED"}
INT32, REAL32 = 6, 9
HOVER, READY_S, LANDED_M = 0.435, 2.0, 0.3
HOLD, LAND, TAKEOFF, MISSION, POSITION, OFFBOARD = (4, 3), (4, 6), (4, 2), (4, 4), (3, 0), (6, 0)
SPEED_MPS, TURN_RPS = 5.0, 1.0  # of set-points at most, and of a stick held over
PLACE, METRES_PER_DEGREE = (47.3977419, 8.5455938), 111_195.0
HOME_MM = 488_786  # above sea
OWN_STEP_S, GRAVITY, LIFT_LAG = 0.005, 9.81, 0.1


def spin() -> None:
    """Work on and on, below the threads that fly: those answer all the same."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    pbkdf2_hmac("sha256", b"", b"", 10**9)


class Simulator:
    """The link to the world."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.mav = dialect.MAVLink(self, srcSystem=1, srcComponent=1)

    def write(self, data: bytes) -> None:
        """Send what pymavlink packed."""
        self.socket.sendall(data)

    def messages(self) -> list[Any]:
        """Wait for some."""
        data = self.socket.recv(65536)
        if not data:
            sys.exit(0)
        return self.mav.parse_buffer(data) or []


class Peer:
    """One vehicle: its links, its parameters, what it does."""

    def __init__(self, folder: Path) -> None:
        texts = {path.name: path.read_text() for path in (folder / "etc" / "init.d-posix").iterdir()}
        simulator = re.search(r"-c (\d+)", texts["px4-rc.mavlinksim"])
        ground = re.search(r"-u (\d+) -o (\d+)", texts["px4-rc.mavlink"])
        assert simulator is not None
        assert ground is not None
        self.own_physics = os.environ["PX4_SIM_MODEL"].startswith("sihsim")
        self.parameters = {**NAMES, **(OWN_NAMES if self.own_physics else {})}
        for name, value in os.environ.items():
            if name.startswith("PX4_PARAM_"):
                self.parameters[name.removeprefix("PX4_PARAM_")] = float(value)
        print("px4 starting.", flush=True)
        print("Startup script returned successfully", flush=True)
        self.simulator = None if self.own_physics else Simulator(int(simulator[1]))
        self.outputs = [0.0] * 4
        self.items: list[Any] = []
        self.item, self.yaw = 0, 0.2
        self.spins: threading.Thread | None = None
        self.given = 0
        self.aim = [0.0, 0.0]
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("127.0.0.1", int(ground[1])))
        self.udp.setblocking(False)
        self.ground = ("127.0.0.1", int(ground[2]))
        self.mav = dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.intervals_s = {"HEARTBEAT": 1.0}
        self.due_s: dict[str, float] = {}
        self.time_s = self.altitude_m = self.climb_mps = 0.0
        self.zero_m: float | None = None
        self.angles, self.speeds, self.places = [0.0] * 3, [0.0] * 2, [0.0] * 2
        self.rates = [0.0] * 3
        self.pulses: list[int] = []
        self.mode, self.armed, self.target_m, self.gps = HOLD, False, 0.0, 0

    def write(self, data: bytes) -> None:
        """Send what pymavlink packed."""
        self.udp.sendto(data, self.ground)

    def run(self) -> None:
        """Fly until the world hangs up."""
        if self.simulator is None:
            self.run_own()
        while True:
            for message in self.simulator.messages():
                kind = message.get_type()
                if kind == "HIL_GPS":
                    self.on_gps(message)
                elif kind == "RC_CHANNELS":
                    self.pulses = [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw]
                elif kind == "HIL_SENSOR":
                    self.on_sensors(message)

    def run_own(self) -> NoReturn:
        """Step its own physics as PX4's does: look at the wall clock, step, sleep."""
        library, now = ctypes.CDLL(None), (ctypes.c_long * 2)()
        while True:
            library.gettimeofday(now, None)
            self.own_step()
            library.usleep(5000)

    def own_step(self) -> None:
        """Lift the mass by the throttles of the step before; the ground stops it."""
        self.time_s += OWN_STEP_S
        lift = GRAVITY * (sum(self.outputs) / 4.0 / HOVER - 1.0)
        self.climb_mps += OWN_STEP_S * (lift - LIFT_LAG * self.climb_mps)
        self.altitude_m += OWN_STEP_S * self.climb_mps
        if self.altitude_m < 0.0:
            self.altitude_m = self.climb_mps = 0.0
        self.zero_m, self.gps = 0.001 * HOME_MM, self.gps + 1
        self.go()
        self.turn()
        self.outputs = self.throttles()

    def go(self) -> None:
        """Move over ground: to the set-point of OFFBOARD, or as the sticks say; take off by the mission's item."""
        if self.mode == MISSION and self.items:
            lifts = next(number for number, item in enumerate(self.items) if item.command == 22)
            self.target_m, self.item = self.items[lifts].z, lifts
            if self.altitude_m > self.target_m - 0.5:
                self.item = lifts + 1
        speeds = [0.0, 0.0]
        if self.mode == OFFBOARD:
            ways = [to - at for to, at in zip(self.aim, self.places, strict=True)]
            much = min(SPEED_MPS, 2.0 * math.hypot(*ways)) / max(math.hypot(*ways), 1e-6)
            speeds = [much * way for way in ways]
        elif self.mode == POSITION and self.pulses:
            roll, pitch, _, yaw = ((pulse - 1500) / 500 for pulse in self.pulses)
            self.yaw += OWN_STEP_S * TURN_RPS * yaw
            ahead, right = -SPEED_MPS * pitch, SPEED_MPS * roll
            cos, sin = math.cos(self.yaw), math.sin(self.yaw)
            speeds = [ahead * cos - right * sin, ahead * sin + right * cos]
        self.speeds = speeds
        self.places = [at + OWN_STEP_S * speed for at, speed in zip(self.places, speeds, strict=True)]

    def on_gps(self, message: Any) -> None:
        self.gps += 1
        self.speeds, self.climb_mps = [message.vn * 0.01, message.ve * 0.01], -message.vd * 0.01
        self.places = [one + 0.1 * speed for one, speed in zip(self.places, self.speeds, strict=True)]

    def on_sensors(self, message: Any) -> None:
        step_s, self.time_s = message.time_usec * 1e-6 - self.time_s, message.time_usec * 1e-6
        self.rates = [message.xgyro, message.ygyro, message.zgyro]
        self.angles = [one + rate * min(step_s, 0.01) for one, rate in zip(self.angles, self.rates, strict=True)]
        self.zero_m = message.pressure_alt if self.zero_m is None else self.zero_m
        self.altitude_m += 0.02 * (message.pressure_alt - self.zero_m - self.altitude_m) + step_s * self.climb_mps
        self.turn()
        assert self.simulator is not None
        controls = self.throttles() + [0.0] * 12
        self.given += 1
        if self.parameters["SIM_SPARSE"] and self.given % 4:
            return
        self.simulator.mav.hil_actuator_controls_send(message.time_usec, controls, 128 * self.armed + 1, 1)

    def turn(self) -> None:
        """Hear and say what there is; end where told to."""
        self.hear()
        self.tell()
        if self.parameters["SIM_DIE"]:
            print("PANIC: told to at 0xabc", flush=True)
            os.kill(os.getpid(), signal.SIGABRT)
        if self.parameters["SIM_HANG"]:
            signal.pause()
        if self.parameters["SIM_SPIN"] and self.armed and not self.spins:
            self.spins = threading.Thread(target=spin, daemon=True)
            self.spins.start()

    def throttles(self) -> list[float]:
        """Level out, hold the place, seek the height."""
        if not self.armed or self.parameters["SIM_CUT"]:
            return [0.0] * 4
        climb = -0.5 if self.mode == LAND else max(-1.0, min(2.0, self.target_m - self.altitude_m))
        if self.mode == LAND and self.altitude_m < LANDED_M and self.climb_mps > -0.2:
            self.armed = False
        lift = HOVER + 0.06 * (climb - self.climb_mps)
        lean = [
            max(-0.1, min(0.1, -0.06 * (speed + 0.3 * place)))
            for place, speed in zip(self.places, self.speeds, strict=True)
        ]
        (roll, pitch, yaw), (p, q, r) = self.angles, self.rates
        turn_roll, turn_pitch = 0.09 * (4.5 * (lean[1] - roll) - p), 0.09 * (4.5 * (-lean[0] - pitch) - q)
        turn_yaw = 0.1 * (-2.0 * yaw - r)
        mix = ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))  # front right, rear left, front left, rear right
        return [max(0.0, min(1.0, lift + a * turn_roll + b * turn_pitch + c * turn_yaw)) for a, b, c in mix]

    # -- MAVLink --------------------------------------------------------------------------------------------------

    def hear(self) -> None:
        """Take what came in."""
        while True:
            try:
                data = self.udp.recv(65536)
            except BlockingIOError:
                return
            for message in self.mav.parse_buffer(data) or ():
                taker: Callable[[Any], None] | None = getattr(self, f"on_{message.get_type().lower()}", None)
                if taker is not None:
                    taker(message)

    def say_parameter(self, name: str, index: int) -> None:
        """Whole numbers go as their bytes, as PX4 sends them."""
        value, kind = self.parameters[name], INT32 if name in WHOLE else REAL32
        packed: float = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == INT32 else value
        self.mav.param_value_send(name.encode(), packed, kind, len(self.parameters), index)

    def on_param_request_list(self, message: Any) -> None:
        for index, name in enumerate(sorted(self.parameters)):
            self.say_parameter(name, index)

    def on_param_set(self, message: Any) -> None:
        name, value = message.param_id, message.param_value
        if name in self.parameters:
            self.parameters[name] = struct.unpack("<i", struct.pack("<f", value))[0] if name in WHOLE else value
            self.say_parameter(name, 65535)

    def on_command_long(self, message: Any) -> None:
        result = dialect.MAV_RESULT_ACCEPTED
        if message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            name = dialect.mavlink_map[int(message.param1)].msgname
            if name != "HEARTBEAT":  # once a second, whatever is asked for
                self.intervals_s[name] = message.param2 * 1e-6
        elif message.command == dialect.MAV_CMD_DO_SET_MODE:
            if message.param2 == 3 and not self.pulses:
                result = dialect.MAV_RESULT_DENIED
            elif message.param2 != 5:  # ACRO is acknowledged and ignored
                self.mode = (int(message.param2), int(message.param3))
        elif message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 > 0.5
        elif message.command == dialect.MAV_CMD_NAV_TAKEOFF:
            self.mode, self.target_m = TAKEOFF, message.param7 - (self.zero_m or 0.0)
        elif message.command == dialect.MAV_CMD_INJECT_FAILURE:
            result = dialect.MAV_RESULT_UNSUPPORTED
        self.mav.command_ack_send(message.command, result)

    def on_rc_channels_override(self, message: Any) -> None:
        self.pulses = [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw]

    def on_mission_count(self, message: Any) -> None:
        self.items, self.expected, self.asking = [], message.count, message
        self.ask_for_item(1 if self.parameters["SIM_NO_MISSION"] else 0)

    def ask_for_item(self, number: int) -> None:
        self.mav.mission_request_int_send(self.asking.get_srcSystem(), self.asking.get_srcComponent(), number)

    def on_mission_item_int(self, message: Any) -> None:
        self.items.append(message)
        refused = self.parameters["SIM_NO_MISSION"] != 0.0
        if len(self.items) < self.expected and not refused:
            self.ask_for_item(len(self.items))
            return
        result = dialect.MAV_MISSION_UNSUPPORTED if refused else dialect.MAV_MISSION_ACCEPTED
        self.mav.mission_ack_send(message.get_srcSystem(), message.get_srcComponent(), result)

    def on_set_position_target_local_ned(self, message: Any) -> None:
        self.aim = [message.x, message.y]
        if self.mode == OFFBOARD:
            self.target_m, self.yaw = -message.z, message.yaw

    def tell(self) -> None:
        """Say what is due."""
        for name, every_s in self.intervals_s.items():
            if self.time_s >= self.due_s.get(name, 0.0) - 1e-6:
                self.due_s[name] = self.time_s + every_s
                say: Callable[[], None] | None = getattr(self, f"say_{name.lower()}", None)
                if say is not None:
                    say()

    def say_heartbeat(self) -> None:
        main, sub = self.mode
        self.mav.heartbeat_send(2, 12, 1 + 128 * self.armed, main << 16 | sub << 24, 4 if self.armed else 3)

    def say_high_latency2(self) -> None:
        main, sub = self.mode
        self.mav.high_latency2_send(0, 2, 12, main | sub << 8, *[0] * 19, 0, 0, 0, 0)

    def say_sys_status(self) -> None:
        ready = self.time_s > READY_S and self.gps > 5 and not self.parameters["SIM_NEVER_READY"]
        health = 8 + 65536 * bool(self.pulses) + (dialect.MAV_SYS_STATUS_PREARM_CHECK if ready else 0)
        self.mav.sys_status_send(health, health, health, 0, 16_200, 100, 90, 0, 0, 0, 0, 0, 0)

    def say_home_position(self) -> None:
        self.mav.home_position_send(473977419, 85455938, HOME_MM, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)

    def say_gps_raw_int(self) -> None:
        self.mav.gps_raw_int_send(0, 3, 0, 0, HOME_MM + round(1000 * self.altitude_m), 0, 0, 0, 0, 10)

    def say_extended_sys_state(self) -> None:
        self.mav.extended_sys_state_send(0, 1 if self.altitude_m < LANDED_M and not self.armed else 2)

    def say_global_position_int(self) -> None:
        height_mm = round(1000 * self.altitude_m)
        self.mav.global_position_int_send(0, 0, 0, HOME_MM + height_mm, height_mm, 0, 0, 0, 0)

    def say_local_position_ned(self) -> None:
        self.mav.local_position_ned_send(0, *self.places, -self.altitude_m, *self.speeds, -self.climb_mps)

    def say_hil_state_quaternion(self) -> None:
        up_mm, down_cmps = HOME_MM + round(1000 * self.altitude_m), round(-100 * self.climb_mps)
        north, east = (at / METRES_PER_DEGREE for at in self.places)
        place = [round(1e7 * (PLACE[0] + north)), round(1e7 * (PLACE[1] + east / math.cos(math.radians(PLACE[0]))))]
        speeds = [round(100 * speed) for speed in self.speeds]
        turned = [math.cos(self.yaw / 2), 0.0, 0.0, math.sin(self.yaw / 2)]
        self.mav.hil_state_quaternion_send(0, turned, 0, 0, 0, *place, up_mm, *speeds, down_cmps, 0, 0, 0, 0, 0)

    def say_hil_actuator_controls(self) -> None:
        self.mav.hil_actuator_controls_send(0, self.outputs + [0.0] * 12, 128 * self.armed + 1, 1)

    def say_mission_current(self) -> None:
        self.mav.mission_current_send(self.item)

    def say_rc_channels(self) -> None:
        if self.pulses:
            self.mav.rc_channels_send(0, 4, *self.pulses, *[65535] * 14, 100)


def main() -> None:
    """Take the words that matter from the autopilot's command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-i")
    parser.add_argument("-d", action="store_true")
    parser.add_argument("-w", type=Path)
    Peer(parser.parse_args().w).run()


if __name__ == "__main__":
    main()
