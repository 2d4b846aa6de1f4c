"""PX4 on its own physics (SIH): the gate that holds it between steps, the truth it says, what cannot be given there."""

from __future__ import annotations

import math
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from external_stand_ins import Deaf, printed
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.errors import Refused
from saflite.contract.test_case import Obstacle, Scenario, Setting, StartState, Stimulus, Target, TestCase, Wind
from saflite.flight.autopilots.external.link import SimulatedClock, bound_udp
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.external.place import FailedBringUp
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.vehicle import GONE, OK
from saflite.flight.autopilots.px4.check import check_test_case
from saflite.flight.autopilots.px4.describe import SETTINGS, describe
from saflite.flight.autopilots.px4.gate import LIBRARY, UNGATED, Gate
from saflite.flight.autopilots.px4.inputs import NOT_OWN_PHYSICS, OWN, OWN_PHYSICS
from saflite.flight.autopilots.px4.own_truth import OwnTruth
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.geometry import boxes_array
from saflite.flight.mavlink.client import Client
from saflite.flight.world.state import CRASHED
from saflite.mutator.operators.inputs import target_inputs
from saflite.mutator.strategies.exposure import _without
from saflite.mutator.strategies.pgfuzz import Strategy

HOME = (47.3977419, 8.5455938, 488.79)
INT32, REAL32 = 6, 9
LISTING = Listing(
    binary="0" * 64,
    parameters={
        "GF_ACTION": Row(2.0, INT32),
        "SIH_VEHICLE_TYPE": Row(0.0, INT32),
        "SIM_GPS_USED": Row(10.0, INT32),
        "SIM_BARO_OFF_P": Row(0.0, REAL32),
    },
)
OWN_PHYSICS_OF: dict[str, Setting] = {"physics": "sih"}
STEPS = """
import ctypes, sys, threading
library, now = ctypes.CDLL(None), (ctypes.c_long * 2)()
other = threading.Thread(target=lambda: [library.usleep(1) for _ in range(100)])  # no step: it never looks at the clock
other.start(), other.join()
library.usleep(1)  # neither: not yet
for step in range(1, int(sys.argv[1]) + 1):
    library.gettimeofday(now, None)
    library.gettimeofday(now, None)
    print(step, flush=True)
    library.usleep(1)
"""


@contextmanager
def gated(steps: int) -> Iterator[tuple[Vehicle, subprocess.Popen[bytes]]]:
    """Run a program that steps as SIH does, with the gate preloaded; yield our end and it."""
    gate, udp = Gate(), bound_udp(0)
    words = [sys.executable, "-c", STEPS, str(steps)]
    told, keeps = {**os.environ, **gate.environment}, [gate.theirs.fileno()]
    with subprocess.Popen(words, env=told, pass_fds=keeps, stdout=subprocess.PIPE, bufsize=0) as running:
        gate.theirs.close()
        assert len(gate.channel.recv(4)) == 4
        vehicle = Vehicle(np.zeros((0, 8)), 0.0, 1)
        vehicle.connect(gate.channel, udp, HOME, own_physics=True)
        try:
            yield vehicle, running
        finally:
            running.kill()
            gate.close()
            udp.close()


def test_it_runs_the_steps_that_are_ordered_and_no_more() -> None:
    with gated(1000) as (vehicle, running):
        assert printed(running, 1) == [1]
        assert vehicle.run(8) == OK  # four of its steps of 5 ms
        assert printed(running, 5) == [2, 3, 4, 5]
        assert vehicle.run(2) == OK
        assert printed(running, 6) == [6]
        assert running.stdout is not None
        assert select.select([running.stdout], [], [], 0.2)[0] == []
        assert (vehicle["step"], vehicle["time_s"]) == (10.0, 10 * 0.0025)


def test_its_end_is_told_and_a_crashed_vehicle_is_not_run_on() -> None:
    with gated(4) as (vehicle, running):
        vehicle["world_state"] = CRASHED
        assert vehicle.run(8) == OK
        assert vehicle["step"] == 0.0
        vehicle["world_state"] = 0.0
        assert vehicle.run(8) == GONE
        assert running.wait(5.0) == 0


def test_without_a_world_to_ask_the_program_ends() -> None:
    told = {**os.environ, "LD_PRELOAD": str(LIBRARY), "SAFLITE_GATE": "1"}
    done = subprocess.run([sys.executable, "-c", STEPS, "5"], env=told, check=False, timeout=20.0)
    assert done.returncode == 3


@pytest.mark.parametrize(("words", "said"), [("echo no SIH; exit 3", "exit code 3: no SIH"), ("sleep 9", UNGATED)])
def test_a_program_whose_physics_never_waits_is_told(tmp_path: Path, words: str, said: str) -> None:
    gate = Gate()
    process = Process(["/bin/sh", "-c", words], tmp_path, environment=gate.environment, keeps=(gate.theirs.fileno(),))
    gate.theirs.close()
    with pytest.raises(FailedBringUp, match=said):
        gate.greet(process, 1.0)
    process.end()
    gate.close()


# ---- truth --------------------------------------------------------------------------------------------------------


def said(kind: str, **fields: Any) -> Any:
    made = dialect.mavlink_map[getattr(dialect, f"MAVLINK_MSG_ID_{kind}")]
    values = [fields.get(name, 0) for name in made.fieldnames]
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return dialect.MAVLink(None).parse_buffer(made(*values).pack(link))[0]


def state(*, up_m: float = 20.0, down_mps: float = 0.0, roll_rad: float = 0.0, north_m: float = 0.0) -> Any:
    turn = [math.cos(roll_rad / 2), math.sin(roll_rad / 2), 0.0, 0.0]
    place = {"lat": round((HOME[0] + north_m / 111_195.0) * 1e7), "lon": round(HOME[1] * 1e7)}
    height = {"alt": round(1e3 * (HOME[2] + up_m)), "vz": round(100 * down_mps)}
    return said("HIL_STATE_QUATERNION", attitude_quaternion=turn, **place, **height)


def truth_of(*boxes: Obstacle) -> tuple[Vehicle, OwnTruth]:
    vehicle = Vehicle(boxes_array(boxes), 0.0, 1)
    return vehicle, OwnTruth(vehicle, Client(SimulatedClock(vehicle), Deaf()), LISTING.values, HOME)


def test_the_truth_is_what_it_says() -> None:
    vehicle, told = truth_of()
    turn = [math.cos(0.2), 0.0, 0.0, -math.sin(0.2)]
    place = {"lat": round((HOME[0] + 10.0 / 111_195.0) * 1e7), "lon": round(HOME[1] * 1e7), "alt": 508790}
    speeds = {"vx": 100, "vy": -200, "vz": 300, "yawspeed": 0.5}
    told.take(said("HIL_STATE_QUATERNION", attitude_quaternion=turn, **place, **speeds), 1.0)
    assert vehicle["x_m"] == pytest.approx(10.0, abs=0.05)
    assert vehicle["altitude_m"] == pytest.approx(20.0, abs=1e-3)
    assert [vehicle[name] for name in ("vx_mps", "vy_mps", "climb_mps")] == [1.0, -2.0, -3.0]
    assert vehicle["yaw_deg"] == pytest.approx(360.0 - math.degrees(0.4), abs=1e-3)
    assert vehicle["yaw_rate_dps"] == pytest.approx(math.degrees(0.5), abs=1e-3)
    told.take(state(roll_rad=0.1), 1.1)
    assert (vehicle["roll_deg"], vehicle["pitch_deg"]) == pytest.approx((math.degrees(0.1), 0.0), abs=1e-4)


def test_its_motors_and_whether_it_is_armed_are_what_it_says() -> None:
    vehicle, told = truth_of()
    controls = [0.5, 0.25, math.nan, -1.0, *[0.0] * 12]
    told.take(said("HIL_ACTUATOR_CONTROLS", controls=controls, mode=129), 1.0)
    assert [vehicle[f"command_{number}"] for number in (1, 2, 3, 4)] == [0.5, 0.25, 0.0, 0.0]
    assert (vehicle["armed"], vehicle["throttle"]) == (1.0, 0.1875)
    told.take(said("HIL_ACTUATOR_CONTROLS", controls=controls, mode=1), 1.1)
    assert (vehicle["armed"], vehicle["command_1"]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("sink_mps", "roll_rad", "crashed"), [(0.4, 0.0, False), (3.4, 0.0, False), (3.6, 0.0, True), (0.4, 1.0, True)]
)
def test_the_last_word_before_the_touch_down_tells_a_crash(sink_mps: float, roll_rad: float, crashed: bool) -> None:
    vehicle, told = truth_of()
    told.take(state(up_m=0.0, down_mps=9.0), 0.1)  # it has not flown yet
    assert vehicle["world_state"] != CRASHED
    told.take(state(up_m=1.0), 0.5)
    told.take(state(up_m=0.1, down_mps=sink_mps, roll_rad=roll_rad), 0.9)
    assert vehicle["world_state"] != CRASHED
    told.take(state(up_m=0.0), 0.92)
    assert (vehicle["world_state"] == CRASHED) == crashed


def test_boxes_are_measured_and_end_the_flight() -> None:
    vehicle, told = truth_of(Obstacle(length_m=4, width_m=4, height_m=25, x_m=10, y_m=0))
    told.take(state(), 1.0)
    assert vehicle["obstacle_distance_m"] == pytest.approx(8.0, abs=0.3)
    assert vehicle["world_state"] != CRASHED
    told.take(state(north_m=9.0), 2.0)
    assert vehicle["world_state"] == CRASHED


# ---- the test case ------------------------------------------------------------------------------------------------


def case(*stimuli: Stimulus, scenario: Scenario | None = None) -> TestCase:
    target = Target(name="px4", settings=OWN_PHYSICS_OF)
    return TestCase(target=target, scenario=scenario or Scenario(start=StartState(mode="BRAKE")), stimuli=stimuli)


def fault(name: str, value: float = 0.1) -> Stimulus:
    return Stimulus(at_s=0.0, kind="sensor_fault", name=name, values=(value,))


@pytest.mark.parametrize("name", ["radio_loss", "gps_satellites", "baro_offset", "gps_off", "motor_off"])
def test_faults_that_its_own_physics_has_are_taken(name: str) -> None:
    check_test_case(case(fault(name, 1.0)), LISTING)


@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("gyro_noise", "got physics = sih"),
        ("motor_failed", "got physics = sih"),
        ("compass_offset_x", "got physics = sih of a build without SIM_MAG_OFFSET_X"),
    ],
)
def test_faults_that_only_our_world_makes_are_refused(name: str, got: str) -> None:
    check_test_case(TestCase(target=Target(name="px4"), scenario=case().scenario, stimuli=(fault(name),)), LISTING)
    with pytest.raises(Refused, match="radio_loss, gps_satellites, baro_offset") as caught:
        check_test_case(case(fault(name)), LISTING)
    assert str(caught.value).endswith(got)


def test_wind_is_refused_and_so_is_a_build_without_it() -> None:
    with pytest.raises(Refused, match="its air stands still"):
        check_test_case(case(scenario=Scenario(start=StartState(mode="BRAKE"), wind=Wind(mean_mps=3.0))), LISTING)
    bare = Listing(binary="0" * 64, parameters={"GF_ACTION": Row(2.0, INT32)})
    with pytest.raises(Refused, match="a build that starts on it"):
        check_test_case(case(), bare)


def test_every_fault_of_our_world_is_given_there_by_a_way_or_named_as_lacking() -> None:
    assert {*OWN_PHYSICS, *NOT_OWN_PHYSICS, "radio_loss"} == set(OWN)
    assert SETTINGS["physics"].lacks == {"sih": NOT_OWN_PHYSICS}


def test_a_search_draws_nothing_that_its_own_physics_lacks() -> None:
    info = describe(None, None, "")
    settings: dict[str, Setting] = {"sensor_faults": ["gps_offset_north", "baro_offset"]}
    assert info.lacking({}) == frozenset()
    names = {name for _, name in target_inputs(info, OWN_PHYSICS_OF)}
    assert "gps_offset_north" not in names
    assert {"baro_offset", "gps_off", "RC1"} <= names
    own, ours = (
        Strategy(one, settings, (), info)
        for one in (case(), TestCase(target=Target(name="px4"), scenario=case().scenario))
    )
    assert [entry.name for entry in own._own] == ["baro_offset"]
    assert [entry.name for entry in ours._own] == ["gps_offset_north", "baro_offset"]
    hint = "px-hold1 reads:sensor_fault:gps_offset_north sensor_fault:baro_offset"
    assert _without(hint, info.lacking(OWN_PHYSICS_OF)) == "px-hold1 sensor_fault:baro_offset"
