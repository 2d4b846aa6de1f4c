"""The world and the sensors alone, from Python and from C: no autopilot anywhere."""

from __future__ import annotations

import ctypes
import importlib.util
import math
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.test_case import Obstacle, Wind
from saflite.flight.geometry import boxes_array
from saflite.flight.native_library import LIBRARY
from saflite.flight.sensors.faults import FAULTS
from saflite.flight.sensors.sensors import Readings, Sensors
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import CRASHED, FLYING, FROZEN, STANDING, STEP_S, WorldState
from saflite.flight.world.wind import WindField

HOVER, OFF = (0.435,) * 4, (0.0,) * 4
ROOT = Path(__file__).resolve().parents[3]
BRIDGE = ROOT / "scripts" / "benches" / "_hover.c"


def stepped(world: World, throttles: tuple[float, ...], steps: int) -> WorldState:
    for _ in range(steps):
        world.step(throttles)
    return world.state


def test_a_standing_vehicle_stays_until_its_first_throttle() -> None:
    world = World()
    state = stepped(world, OFF, 400)
    assert (state.world_state, state.step, state.force_z_mps2) == (STANDING, 400, -9.80665)
    assert state.time_s == pytest.approx(1.0)
    state = stepped(world, (0.7,) * 4, 400)
    assert state.world_state == FLYING
    assert state.climb_mps > 1.0
    assert state.altitude_m > 0.5


def test_more_throttle_climbs_and_a_failed_motor_tips_it_over() -> None:
    slow, fast, hurt = (World(50.0) for _ in range(3))
    hurt.fail_motor(1, 0.2)
    assert stepped(fast, (0.6,) * 4, 200).climb_mps > stepped(slow, (0.5,) * 4, 200).climb_mps
    state = stepped(hurt, (0.5,) * 4, 200)
    assert (state.motor_1, state.motor_2, state.command_1) == (0.1, 0.5, 0.5)
    assert abs(state.roll_deg) > 10.0


def test_truth_of_position_can_be_told_less_often() -> None:
    world = World(20.0, steps_per_state=8)
    heights = [world.step((0.6,) * 4).altitude_m for _ in range(16)]
    assert len(set(heights)) == 3
    assert heights[0] == heights[6] != heights[7] == heights[14] != heights[15]


def test_wind_carries_and_a_fall_ends_as_a_crash() -> None:
    world = World(30.0)
    world.set_wind(0.0, 8.0, 0.0)
    assert stepped(world, HOVER, 800).vy_mps > 0.1
    state = stepped(World(3.0), OFF, 800)
    assert state.world_state == CRASHED
    assert state.altitude_m < 0.25


@pytest.mark.parametrize("height_m", [30.0, 45.0, 54.0, 57.0, 60.0])
def test_a_fast_fall_is_no_bounce_wherever_between_two_states_it_meets_the_ground(height_m: float) -> None:
    """From 57 m the ground threw it back between two states: both found it above a quarter of a metre."""
    world = World(height_m, steps_per_state=8)
    lowest_m = height_m
    for number in range(4000):
        state = world.step((0.6, 0.6, 0.4, 0.4) if number < 120 else OFF)
        lowest_m = min(lowest_m, state.altitude_m)
        if state.world_state == CRASHED:
            break
        assert lowest_m > 3.0 or state.altitude_m <= lowest_m + 0.5, "thrown back by the ground, and flies on"
    assert state.world_state == CRASHED


def test_touching_down_under_the_parachute_stops_the_world_unharmed() -> None:
    world = World(3.0)
    world["chute_released"] = 1.0
    assert stepped(world, OFF, 800).world_state == FROZEN


def test_a_box_is_seen_at_its_edge_and_hit_at_its_core() -> None:
    box = Obstacle(length_m=10, width_m=10, height_m=20, x_m=0, y_m=20, rotation_deg=0)
    world = World(10.0, boxes=boxes_array((box,)))
    assert world.state.obstacle_distance_m == pytest.approx(15.0)
    inside = Obstacle(length_m=10, width_m=10, height_m=20, x_m=0, y_m=4.1, rotation_deg=0)
    edge = Obstacle(length_m=10, width_m=10, height_m=20, x_m=0, y_m=4.2, rotation_deg=0)
    for one, contact in ((inside, 1.0), (edge, 0.0)):
        state = stepped(World(10.0, boxes=boxes_array((one,))), HOVER, 1)
        assert (state.obstacle_distance_m, state.contact) == (0.0, contact)
        assert state.world_state == (CRASHED if contact else FLYING)


def test_four_throttles_are_needed() -> None:
    with pytest.raises(Refused, match="actuators"):
        World().step((0.5, 0.5))


def read(rng_seed: int, steps: int, **faults: float) -> list[Readings]:
    """Read a standing vehicle's sensors."""
    world, sensors = World(), Sensors(rng_seed)
    for name, size in faults.items():
        sensors.set_fault(name, size)
    return [sensors.read(world.step(OFF)) for _ in range(steps)]


def test_noise_has_the_size_it_says_and_follows_the_seed() -> None:
    first, again, other = read(1, 4000), read(1, 4000), read(2, 4000)
    assert first == again
    assert first[-1] != other[-1]
    assert np.std([row.gyro_x_rps for row in first]) == pytest.approx(0.003, rel=0.1)
    assert np.std([row.acc_z_mps2 for row in first]) == pytest.approx(0.05, rel=0.1)
    assert np.mean([row.acc_z_mps2 for row in first]) == pytest.approx(-9.81, abs=0.1)
    baro = [row.baro_m for row in first[::8]]
    assert np.std(np.diff(baro)) == pytest.approx(0.06 * math.sqrt(2), rel=0.15)


def test_sensors_answer_at_rates_of_their_own() -> None:
    rows = read(1, 400)
    assert len({row.gyro_x_rps for row in rows}) == 400
    assert len({row.baro_m for row in rows}) == 51
    assert len({row.gps_north_m for row in rows}) == 11


CHANGES = {
    "gps_loss": ("gps_satellites", -10.0),
    "gps_satellites": ("gps_satellites", -3.0),
    "baro_loss": ("baro_alive", -1.0),
    "baro_drift": ("baro_m", 2.0),
    "gps_height_drift": ("gps_up_m", 2.0),
    "gps_offset_north": ("gps_north_m", 2.0),
    "gps_offset_east": ("gps_east_m", 2.0),
    "gps_offset_up": ("gps_up_m", 2.0),
    "baro_offset": ("baro_m", 2.0),
    "battery_voltage": ("pack_v", -4.8),
    **{f"compass_offset_{axis}": (f"compass_{axis}_gauss", 0.2) for axis in "xyz"},
    **{f"gyro_offset_{axis}": (f"gyro_{axis}_rps", 0.2) for axis in "xyz"},
    **{f"accelerometer_offset_{axis}": (f"acc_{axis}_mps2", 2.0) for axis in "xyz"},
}
SIZES = {"gps_loss": 1, "baro_loss": 1, "gps_satellites": 7, "battery_voltage": 12} | {
    f"{kind}_offset_{axis}": 0.2 for kind in ("compass", "gyro") for axis in "xyz"
}
NOISES = {
    "gps_noise": "gps_north_m",
    "baro_noise": "baro_m",
    "compass_noise": "compass_x_gauss",
    "gyro_noise": "gyro_x_rps",
    "accelerometer_noise": "acc_x_mps2",
}


def test_every_fault_is_tried() -> None:
    assert set(CHANGES) | set(NOISES) == set(FAULTS)


@pytest.mark.parametrize("fault", CHANGES)
def test_a_fault_shifts_its_own_reading_and_no_other(fault: str) -> None:
    reading, shift = CHANGES[fault]
    healthy, faulty = read(1, 400)[-1], read(1, 400, **{fault: SIZES.get(fault, 2.0)})[-1]
    moved = {name for name in Readings._fields if getattr(healthy, name) != getattr(faulty, name)}
    assert reading in moved
    assert {name.split("_")[0] for name in moved} == {reading.split("_")[0]}
    assert len(moved) == 1 or fault in ("gps_loss", "gps_satellites", "gps_height_drift", "baro_loss")
    assert getattr(faulty, reading) - getattr(healthy, reading) == pytest.approx(shift, abs=0.05)


@pytest.mark.parametrize("fault", NOISES)
def test_noise_grows(fault: str) -> None:
    reading = NOISES[fault]
    healthy = [getattr(row, reading) for row in read(1, 2000)]
    faulty = [getattr(row, reading) for row in read(1, 2000, **{fault: FAULTS[fault].high})]
    assert np.std(faulty) > 5.0 * np.std(healthy)


def test_unknown_faults_and_sizes_are_refused() -> None:
    with pytest.raises(Refused, match="sensor fault"):
        Sensors(1).set_fault("SIM_GPS_NOISE", 1.0)
    with pytest.raises(Refused, match="gps_noise"):
        Sensors(1).set_fault("gps_noise", 11.0)


def compiled(folder: Path) -> ctypes.PyDLL:
    """A bridge in C as a target of its own would bring one, linked to the library of the world."""
    library = folder / "bridge.so"
    headers, builder = LIBRARY.parent, build_native()
    command = [*builder.compiler(), "-std=c11", "-O2", "-fPIC", "-shared", f"-I{headers}", "-o", str(library)]
    subprocess.run([*command, str(BRIDGE), str(LIBRARY)], check=True)
    return ctypes.PyDLL(str(library))


def build_native() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_native", ROOT / "scripts" / "build_native.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_bridge_in_c_steps_world_and_sensors_as_python_does(tmp_path: Path) -> None:
    bridge = compiled(tmp_path)
    bridge.hover.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_int]
    world, sensors = World(20.0), Sensors(3)
    assert bridge.hover(world.address, sensors.address, HOVER[0], 800) == 0
    alone, readings = World(20.0), Sensors(3)
    for _ in range(800):
        last = readings.read(alone.step(HOVER))
    assert world.state == alone.state
    assert Readings(*sensors.at[: len(Readings._fields)]) == last
    assert world.state.time_s == pytest.approx(800 * STEP_S)


def test_gusts_have_the_size_asked_for_and_repeat() -> None:
    wind = Wind(mean_mps=5.0, from_deg=90.0, gust_mps=1.0, gust_period_s=1.0)
    first, second = WindField(wind, 7), WindField(wind, 7)
    rows = np.array([first.tick() for _ in range(20_000)])
    assert np.array_equal(rows[:100], np.array([second.tick() for _ in range(100)]))
    assert rows[:, 1].mean() == pytest.approx(-5.0, abs=0.3)
    assert rows[:, 0].std() == pytest.approx(1.0, rel=0.2)
    assert rows[:, 2].std() == pytest.approx(0.33, rel=0.2)
    assert WindField(Wind(), 1).still


def test_a_wind_that_drops_is_told_to_the_world_and_leaves_no_gust() -> None:
    field = WindField(Wind(mean_mps=5.0, gust_mps=2.0), 7)
    assert any(field.tick())
    field.change(0.0, 0.0, 0.0)
    assert not field.still, "the world has not been told yet"
    assert field.tick() == (0.0, 0.0, 0.0)
    assert field.still
