"""The other end of the ArduPilot adapter's links, for tests without the real one: a program started as it would be.

It speaks the JSON backend and MAVLink and hovers, climbs and lands by a few gains. It knows no world: all it has is
what our side sends. Its parameters `SIM_DIE`, `SIM_HANG` and `SIM_CUT` make it end with a panic, fall silent, or
stop its motors.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import signal
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

NAMES = {
    "FRAME_CLASS": 0.0,
    "RTL_ALT": 1500.0,
    "FENCE_ENABLE": 0.0,
    "FENCE_TYPE": 7.0,
    "ATC_RAT_RLL_P": 0.135,
    "SIM_DIE": 0.0,
    "SIM_HANG": 0.0,
    "SIM_CUT": 0.0,
    "SIM_NEVER_READY": 0.0,
}
HOVER, GUIDED, LAND = 0.435, 4, 9
REAL32 = 9
READY_S, LANDED_M = 1.0, 0.05
PIPE_FRAMES = 10


class Peer:
    """One vehicle: its links, its parameters, what it does."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.parameters = dict(NAMES)
        for line in Path(args.defaults).read_text().splitlines():
            name, value = line.split()
            self.parameters[name] = float(value)
        server = socket.create_server(("127.0.0.1", args.base_port))
        print("Waiting for connection ....", flush=True)
        self.tcp, _ = server.accept()
        self.tcp.setblocking(False)
        self.tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.world = ("127.0.0.1", args.sim_port_out)
        self.receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.receiver.bind(("127.0.0.1", args.rc_in_port))
        self.receiver.setblocking(False)
        self.pulses = (0,) * 16
        self.mav = dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.intervals_s = {"HEARTBEAT": 1.0}
        self.due_s: dict[str, float] = {}
        self.state: dict[str, Any] = {"timestamp": 0.0, "position": [0, 0, 0], "velocity": [0, 0, 0]}
        self.state.update(attitude=[0, 0, 0], imu={"gyro": [0, 0, 0]})
        self.mode, self.armed, self.target_m, self.frame = 0, False, 0.0, 0
        self.cut = False
        self.gps = os.pipe()  # to itself, as the simulated GPS of older builds

    def write(self, data: bytes) -> None:
        """Send what pymavlink packed."""
        self.tcp.sendall(data)

    @property
    def time_s(self) -> float:
        return float(self.state["timestamp"])

    @property
    def altitude_m(self) -> float:
        return -float(self.state["position"][2])

    def run(self) -> None:
        """Fly until the world hangs up."""
        while True:
            self.frame += 1
            pulses = [1000 + round(1000 * one) for one in self.throttles()]
            packet = struct.pack("<HHI16H", 18458, 400, self.frame, *pulses, *[1000] * 12)
            for _ in range(1 + self.frame % 2):  # every second one is said twice, as the backend does when it waits
                self.udp.sendto(packet, self.world)
            while not select.select([self.udp], [], [], 0.1)[0]:
                pass  # as the backend waits
            lines = self.udp.recv(65536).decode().split("\n")
            self.state = json.loads(lines[1])
            self.hear()
            self.tell()
            self.pass_on()
            if self.parameters["SIM_DIE"]:
                print("PANIC: told to at 0xabc", flush=True)
                os.kill(os.getpid(), signal.SIGABRT)
            if self.parameters["SIM_HANG"]:
                signal.pause()

    def pass_on(self) -> None:
        """Write to the pipe, and read what was written some frames before: nobody else may have a share in it."""
        os.write(self.gps[1], struct.pack("<I", self.frame))
        if self.frame > PIPE_FRAMES:
            (said,) = struct.unpack("<I", os.read(self.gps[0], 4))
            if said != self.frame - PIPE_FRAMES:
                print(f"PANIC: the pipe holds another's frame: {said - self.frame}", flush=True)
                os.kill(os.getpid(), signal.SIGABRT)

    def throttles(self) -> list[float]:
        """Level out, hold the place, seek the height."""
        self.cut |= self.parameters["SIM_CUT"] == 1 or (self.parameters["SIM_CUT"] == 2 and self.altitude_m > 2.0)
        if not self.armed or self.cut:
            return [0.0] * 4
        (x, y, _), (vx, vy, vz) = self.state["position"], self.state["velocity"]
        (roll, pitch, yaw), (p, q, r) = self.state["attitude"], self.state["imu"]["gyro"]
        if self.mode == LAND:
            climb = -0.5
            if self.altitude_m < LANDED_M:
                self.armed = False
        else:
            climb = max(-1.0, min(2.0, self.target_m - self.altitude_m))
        lift = HOVER + 0.06 * (climb + vz) if self.target_m > 0.0 else 0.1
        lean = [max(-0.2, min(0.2, (-0.4 * place - speed) * 0.1)) for place, speed in ((x, vx), (y, vy))]
        turn_roll = 0.09 * (4.5 * (lean[1] - roll) - p)
        turn_pitch = 0.09 * (4.5 * (-lean[0] - pitch) - q)
        turn_yaw = 0.1 * (-2.0 * yaw - r)
        mix = ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))  # front right, rear left, front left, rear right
        return [max(0.0, min(1.0, lift + a * turn_roll + b * turn_pitch + c * turn_yaw)) for a, b, c in mix]

    # -- MAVLink --------------------------------------------------------------------------------------------------

    def hear(self) -> None:
        """Take what came in."""
        try:
            data = self.tcp.recv(65536)
        except BlockingIOError:
            return
        if not data:
            sys.exit(0)
        for message in self.mav.parse_buffer(data) or ():
            taker: Callable[[Any], None] | None = getattr(self, f"on_{message.get_type().lower()}", None)
            if taker is not None:
                taker(message)

    def on_param_request_list(self, message: Any) -> None:
        for index, name in enumerate(sorted(self.parameters)):
            self.mav.param_value_send(name.encode(), self.parameters[name], REAL32, len(self.parameters), index)

    def on_param_set(self, message: Any) -> None:
        if message.param_id in self.parameters:
            self.parameters[message.param_id] = message.param_value
            self.mav.param_value_send(message.param_id.encode(), message.param_value, REAL32, 0, 65535)

    def on_command_long(self, message: Any) -> None:
        if message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.intervals_s[dialect.mavlink_map[int(message.param1)].msgname] = message.param2 * 1e-6
        elif message.command == dialect.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2)
        elif message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 > 0.5
        elif message.command == dialect.MAV_CMD_NAV_TAKEOFF:
            self.target_m = message.param7
        elif message.command == dialect.MAV_CMD_DO_GRIPPER:
            self.mav.command_ack_send(message.command, dialect.MAV_RESULT_DENIED)
            return
        self.mav.command_ack_send(message.command, dialect.MAV_RESULT_ACCEPTED)

    def on_mission_count(self, message: Any) -> None:
        """Ask for the second item, and take none."""
        self.mav.mission_request_int_send(message.get_srcSystem(), message.get_srcComponent(), 1)

    def on_mission_item_int(self, message: Any) -> None:
        self.mav.mission_ack_send(message.get_srcSystem(), message.get_srcComponent(), dialect.MAV_MISSION_UNSUPPORTED)

    def tell(self) -> None:
        """Say what is due."""
        for name, every_s in self.intervals_s.items():
            if self.time_s >= self.due_s.get(name, 0.0) - 1e-6:
                self.due_s[name] = self.time_s + every_s
                say: Callable[[], None] | None = getattr(self, f"say_{name.lower()}", None)
                if say is not None:
                    say()

    def say_heartbeat(self) -> None:
        self.mav.heartbeat_send(2, 3, 1 + 128 * self.armed, self.mode, 4)

    def say_rc_channels(self) -> None:
        with suppress(BlockingIOError):
            while True:
                self.pulses = struct.unpack("<16H", self.receiver.recv(64))
        self.mav.rc_channels_send(0, 16, *self.pulses, 65535, 65535, 255)

    def say_sys_status(self) -> None:
        ready = self.time_s > READY_S and not self.parameters["SIM_NEVER_READY"]
        health = 65536 + 8 + (dialect.MAV_SYS_STATUS_PREARM_CHECK if ready else 0)
        self.mav.sys_status_send(health, health, health, 0, 12_600, 100, 90, 0, 0, 0, 0, 0, 0)

    def say_ekf_status_report(self) -> None:
        self.mav.ekf_status_report_send(63, 0, 0, 0, 0, 0)

    def say_extended_sys_state(self) -> None:
        self.mav.extended_sys_state_send(0, 1 if self.altitude_m < LANDED_M else 2)

    def say_global_position_int(self) -> None:
        up_mm, home_mm = round(1000 * self.altitude_m), 488_790
        self.mav.global_position_int_send(0, 0, 0, home_mm + up_mm, up_mm, 0, 0, 0, 0)

    def say_local_position_ned(self) -> None:
        self.mav.local_position_ned_send(0, *self.state["position"], *self.state["velocity"])


def main() -> None:
    """Take the words that matter from the autopilot's command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--base-port", type=int)
    parser.add_argument("--sim-port-out", type=int)
    parser.add_argument("--rc-in-port", type=int)
    parser.add_argument("--defaults")
    args, _ = parser.parse_known_args()
    assert math.isfinite(args.base_port)
    Peer(args).run()


if __name__ == "__main__":
    main()
