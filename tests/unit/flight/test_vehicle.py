"""The world, the sensors and the estimator: rest, noise, faults, wind."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.test_case import Wind
from saflite.flight.vehicle import Vehicle, slots
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.wind import WindField

NOTHING = np.zeros((0, 8))


def standing(rng_seed: int = 1) -> tuple[World, Vehicle]:
    world, vehicle = World(), Vehicle(rng_seed, NOTHING)
    world.read(vehicle)
    vehicle.set(
        baro_gain=1.0,
        fault_gps_sats=10.0,
        gps_sats_min=4.0,
        est_gate_m=5.0,
        est_height_noise=3.0,
        est_position_noise=1.0,
    )
    vehicle.set(est_velocity_noise=1.0, est_yaw_noise=0.5, est_acc_noise=0.35, compass_use=1.0, k_input_tc=0.15)
    vehicle.align()
    return world, vehicle


def test_vehicle_at_rest_reads_gravity_and_the_origin() -> None:
    world, vehicle = standing()
    assert abs(vehicle["up_m"]) < 1e-6
    assert vehicle["force_z"] == pytest.approx(-9.8, abs=0.3)
    world.run(vehicle, 400)
    assert vehicle["acc_z"] == pytest.approx(-9.81, abs=0.4)


def test_sensor_noise_has_the_size_it_says_and_follows_the_seed() -> None:
    world, vehicle = standing()
    readings = []
    for _ in range(2000):
        world.run(vehicle, 1)
        readings.append(vehicle["gyro_x"])
    assert np.std(readings) == pytest.approx(0.003, rel=0.15)
    again_world, again = standing()
    again_world.run(again, 2000)
    assert again["gyro_x"] == vehicle["gyro_x"]
    other_world, other = standing(2)
    other_world.run(other, 2000)
    assert other["gyro_x"] != vehicle["gyro_x"]


def test_estimate_stays_near_the_truth_and_a_gps_offset_pulls_it() -> None:
    world, vehicle = standing()
    world.run(vehicle, 4000)
    assert abs(vehicle["est_n"]) < 0.8
    assert abs(vehicle["altitude_est_m"]) < 0.8
    vehicle["fault_gps_north"] = 3.0
    world.run(vehicle, 8000)
    assert vehicle["est_n"] == pytest.approx(3.0, abs=0.8)


def test_gps_jump_is_gated_then_believed() -> None:
    world, vehicle = standing()
    world.run(vehicle, 2000)
    vehicle["fault_gps_east"] = 40.0
    world.run(vehicle, 2000)
    assert abs(vehicle["est_e"]) < 1.0
    assert vehicle["innovation_ratio"] > 0.8
    world.run(vehicle, 4000)
    assert vehicle["est_e"] == pytest.approx(40.0, abs=1.5)


def test_barometer_drift_moves_the_height_and_its_loss_falls_back_on_gps() -> None:
    world, vehicle = standing()
    vehicle["fault_baro_drift"] = 0.5
    world.run(vehicle, 8000)
    assert vehicle["altitude_est_m"] == pytest.approx(10.0, abs=1.5)
    vehicle["fault_baro_off"] = 1.0
    world.run(vehicle, 8000)
    assert vehicle["baro_ok"] == 0.0
    assert vehicle["height_from"] == 2.0
    assert vehicle["altitude_est_m"] == pytest.approx(0.0, abs=1.5)


def test_losing_the_gps_takes_the_position_away() -> None:
    world, vehicle = standing()
    world.run(vehicle, 400)
    vehicle["fault_gps_off"] = 1.0
    world.run(vehicle, 800)
    assert vehicle["gps_ok"] == 0.0
    assert vehicle["position_ok"] == 0.0


def test_slot_names_are_distinct() -> None:
    assert len(slots()) == len(set(slots().values()))
    assert slots()["p_rps"] == 0


def test_gusts_have_the_size_asked_for_and_repeat() -> None:
    wind = Wind(mean_mps=5.0, from_deg=90.0, gust_mps=1.0, gust_period_s=1.0)
    first, second = WindField(wind, 7), WindField(wind, 7)
    rows = np.array([first.tick() for _ in range(20_000)])
    assert np.array_equal(rows[:100], np.array([second.tick() for _ in range(100)]))
    assert rows[:, 1].mean() == pytest.approx(-5.0, abs=0.3)
    assert rows[:, 0].std() == pytest.approx(1.0, rel=0.2)
    assert rows[:, 2].std() == pytest.approx(0.33, rel=0.2)
    assert WindField(Wind(), 1).still
