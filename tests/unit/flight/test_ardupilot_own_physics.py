"""ArduPilot on its own physics: the gate that holds it between frames, the truth it says, what cannot be flown so."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from external_stand_ins import printed

from saflite.contract.errors import Refused
from saflite.contract.test_case import Obstacle, Scenario, StartState, Target, TestCase, Wind
from saflite.flight.autopilots.ardupilot import settings
from saflite.flight.autopilots.ardupilot.bring_up import OWN_MODEL, WORLD_MODEL, command
from saflite.flight.autopilots.ardupilot.check import check_test_case
from saflite.flight.autopilots.ardupilot.gate import LIBRARY, Gate
from saflite.flight.autopilots.ardupilot.own_truth import OwnTruth
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.link import bound_udp
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.external.vehicle import GONE, OK
from saflite.flight.world.state import CRASHED

HOME = (47.3977419, 8.5455938, 488.79)
LISTING = Listing(binary="0" * 64, parameters={"ATC_RAT_RLL_P": Row(0.135, 9), "FRAME_TYPE": Row(0.0, 4)})
FRAMES = """
import os, signal, sys, threading
other = threading.Thread(target=lambda: [os.kill(os.getppid(), 0) for _ in range(100)])  # no frame: not the main thread
other.start(), other.join()
os.kill(os.getpid(), 0)  # neither: not the parent
for frame in range(1, int(sys.argv[1]) + 1):
    print(frame, flush=True)
    os.kill(os.getppid(), 0)
"""


@contextmanager
def gated(frames: int) -> Iterator[tuple[Vehicle, socket.socket, subprocess.Popen[bytes]]]:
    """Run a program that looks for its parent once a frame, with the gate preloaded; yield our ends and it."""
    mavlink, theirs = socket.socketpair()
    gate = Gate(own_physics=True, log=True, physics_port=0, receiver_port=0)
    with closing(gate), mavlink, theirs:
        told, keeps = {**os.environ, **gate.environment}, [gate.theirs.fileno()]
        words = [sys.executable, "-c", FRAMES, str(frames)]
        with subprocess.Popen(words, env=told, pass_fds=keeps, stdout=subprocess.PIPE, bufsize=0) as running:
            gate.theirs.close()
            vehicle = Vehicle(np.zeros((0, 8)), 0.0)
            assert vehicle.connect(gate.channel, mavlink, own_physics=True) == OK
            try:
                yield vehicle, theirs, running
            finally:
                running.kill()


def test_it_runs_the_frames_that_are_ordered_and_no_more() -> None:
    with gated(1000) as (vehicle, _, running):
        assert printed(running, 1) == [1]
        assert vehicle.run(8) == OK
        assert printed(running, 9) == list(range(2, 10))
        assert vehicle.run(3) == OK
        assert printed(running, 12) == [10, 11, 12]
        assert running.stdout is not None
        assert select.select([running.stdout], [], [], 0.2)[0] == []
        assert vehicle["step"] == 11.0
        assert vehicle["time_s"] == 11 * 0.0025
        assert vehicle["altitude_m"] == 0.0  # our world stands


def test_what_it_says_meanwhile_is_heard_and_its_end_is_told() -> None:
    with gated(9) as (vehicle, theirs, running):
        theirs.sendall(b"words")
        assert vehicle.run(8) == OK
        assert vehicle.heard() == b"words"
        theirs.close()
        assert vehicle.run(8) == GONE
        running.wait(5.0)


def test_a_crashed_vehicle_is_not_run_on() -> None:
    with gated(1000) as (vehicle, _, running):
        vehicle["world_state"] = CRASHED
        assert vehicle.run(8) == OK
        assert vehicle["step"] == 0.0
        assert printed(running, 1) == [1]


def test_without_a_world_to_ask_the_program_ends() -> None:
    told = {**os.environ, "LD_PRELOAD": str(LIBRARY), "SAFLITE_GATE": "1:1:0:0:0"}
    done = subprocess.run([sys.executable, "-c", FRAMES, "5"], env=told, check=False, timeout=20.0)
    assert done.returncode == 3


# ---- the thread that plans ways round obstacles, in our world ------------------------------------------------------

PLANS = """
import ctypes, select, socket, sys, threading
libc = ctypes.CDLL(None)
turns = 0
def plan():
    global turns
    while True:
        libc.usleep(1000)
        turns += 1
planner = threading.Thread(target=plan, daemon=True)
planner.start()
libc.pthread_setname_np(ctypes.c_ulong(planner.ident), sys.argv[1].encode())
world = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
before = turns
for frame in range(20):
    world.sendto(b"outputs", ("127.0.0.1", int(sys.argv[2])))
    select.select([world], [], [])
    world.recv(100)
    print(turns - before, flush=True)
"""


def _turns(name: str) -> list[int]:
    """Return how often a thread of that name has slept at the end of each of 20 frames, slowly answered."""
    with bound_udp(0) as world:
        port = world.getsockname()[1]
        gate = Gate(own_physics=False, log=True, physics_port=port, receiver_port=0)
        told, keeps = {**os.environ, **gate.environment}, [gate.theirs.fileno()]
        words = [sys.executable, "-c", PLANS, name, str(port)]
        with closing(gate), subprocess.Popen(words, env=told, pass_fds=keeps, stdout=subprocess.PIPE, text=True) as run:
            for _ in range(20):
                world.settimeout(20.0)
                _, peer = world.recvfrom(100)
                select.select([], [], [], 0.005)
                world.sendto(b"state", peer)
            said, _ = run.communicate(timeout=20.0)
    return [int(line) for line in said.split()]


def test_it_gets_a_turn_a_frame_however_long_the_world_takes() -> None:
    assert _turns("avoidance") == list(range(1, 21))
    assert _turns("another") != list(range(1, 21))


# ---- truth --------------------------------------------------------------------------------------------------------


def said(kind: str, **fields: Any) -> Any:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    made = dialect.mavlink_map[getattr(dialect, f"MAVLINK_MSG_ID_{kind}")]
    values = [fields.get(name, b"" if name == "text" else 0) for name in made.fieldnames]
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return dialect.MAVLink(None).parse_buffer(made(*values).pack(link))[0]


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(np.zeros((0, 8)), 0.0)


def test_the_truth_is_what_the_simulator_says(vehicle: Vehicle) -> None:
    told = OwnTruth(vehicle, LISTING.values, HOME)
    north = round((HOME[0] + 10.0 / 111_195.0) * 1e7)
    state = {"lat_int": north, "lon_int": round(HOME[1] * 1e7), "alt": 508.79, "vn": 1.0, "ve": -2.0, "vd": 3.0}
    told.take(said("SIM_STATE", **state, roll=0.1, yaw=-0.5, zgyro=0.2, zacc=-9.81), 1.0)
    assert vehicle["x_m"] == pytest.approx(10.0, abs=0.05)
    assert vehicle["y_m"] == pytest.approx(0.0, abs=0.02)
    assert vehicle["altitude_m"] == pytest.approx(20.0, abs=1e-3)
    assert [vehicle[name] for name in ("vx_mps", "vy_mps", "climb_mps")] == [1.0, -2.0, -3.0]
    assert vehicle["roll_deg"] == pytest.approx(5.7296, abs=1e-3)
    assert vehicle["yaw_deg"] == pytest.approx(331.352, abs=1e-3)
    assert vehicle["yaw_rate_dps"] == pytest.approx(11.459, abs=1e-3)
    assert vehicle["force_z_mps2"] == pytest.approx(-9.81)


@pytest.mark.parametrize(
    ("sink_mps", "roll_rad", "crashed"), [(0.4, 0.0, False), (3.4, 0.0, False), (3.6, 0.0, True), (0.4, 1.0, True)]
)
def test_the_touch_down_tells_a_crash(vehicle: Vehicle, sink_mps: float, roll_rad: float, crashed: bool) -> None:
    told = OwnTruth(vehicle, LISTING.values, HOME)
    told.take(said("SIM_STATE", alt=HOME[2] + 1.0, roll=roll_rad), 0.9)
    told.take(said("STATUSTEXT", severity=6, text=f"SIM Hit ground at {sink_mps:f} m/s".encode()), 1.0)
    assert (vehicle["world_state"] == CRASHED) == crashed


def test_settling_on_the_ground_before_the_flight_is_no_crash(vehicle: Vehicle) -> None:
    told = OwnTruth(vehicle, LISTING.values, HOME)
    told.take(said("STATUSTEXT", severity=6, text=b"SIM Hit ground at 9.0 m/s"), 1.0)
    assert vehicle["world_state"] != CRASHED


# ---- the test case ------------------------------------------------------------------------------------------------


def test_it_starts_with_its_own_gains_and_its_own_model() -> None:
    start = settings.start_parameters({}, LISTING.parameters, obstacles=False, own_physics=True)
    assert start == {"FRAME_TYPE": 1.0}
    assert "ATC_RAT_RLL_P" in settings.start_parameters({}, LISTING.parameters, obstacles=False)
    build = Binary(Path(__file__), "0" * 64, "ArduCopter V4.5.7")
    assert WORLD_MODEL in command(build, range(20), HOME, 0.0)
    assert OWN_MODEL in command(build, range(20), HOME, 0.0, OWN_MODEL)


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        (
            Scenario(start=StartState(), obstacles=(Obstacle(length_m=1, width_m=1, height_m=9, x_m=5, y_m=5),)),
            "no obstacles",
        ),
        (Scenario(start=StartState(), wind=Wind(mean_mps=3.0)), "set SIM_WIND_SPD"),
    ],
)
def test_what_only_our_world_has_is_refused(scenario: Scenario, expected: str) -> None:
    ours = TestCase(target=Target(name="ardupilot"), scenario=scenario)
    check_test_case(ours, LISTING)
    own = TestCase(target=Target(name="ardupilot", settings={"physics": "native"}), scenario=scenario)
    with pytest.raises(Refused, match=expected):
        check_test_case(own, LISTING)


def test_another_physics_is_refused() -> None:
    case = TestCase(target=Target(name="ardupilot", settings={"physics": "gazebo"}), scenario=Scenario())
    with pytest.raises(Refused, match="native"):
        check_test_case(case, LISTING)
