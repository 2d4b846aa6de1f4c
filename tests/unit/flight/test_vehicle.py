"""The reference's blackboard: world, sensors and estimator in one loop; rest, faults, gating, fallbacks."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.flight.autopilots.reference.vehicle import Vehicle
from saflite.flight.sensors.faults import FAULTS

NOTHING = np.zeros((0, 8))


def standing(rng_seed: int = 1) -> Vehicle:
    vehicle = Vehicle(rng_seed, NOTHING)
    vehicle.set(baro_gain=1.0, gps_sats_min=4.0, est_gate_m=5.0, est_height_noise=3.0, est_position_noise=1.0)
    vehicle.set(est_velocity_noise=1.0, est_yaw_noise=0.5, est_acc_noise=0.35, compass_use=1.0, k_input_tc=0.15)
    vehicle.align()
    return vehicle


def test_vehicle_at_rest_reads_gravity_and_the_origin() -> None:
    vehicle = standing()
    assert abs(vehicle["altitude_m"]) < 1e-6
    assert vehicle["force_z_mps2"] == pytest.approx(-9.8, abs=0.3)
    vehicle.run(400)
    assert vehicle["acc_z_mps2"] == pytest.approx(-9.81, abs=0.4)


def test_estimate_stays_near_the_truth_and_a_gps_offset_pulls_it() -> None:
    vehicle = standing()
    vehicle.run(4000)
    assert abs(vehicle["est_n"]) < 0.8
    assert abs(vehicle["altitude_est_m"]) < 0.8
    vehicle.sensors.set_fault("gps_offset_north", 3.0)
    vehicle.run(8000)
    assert vehicle["est_n"] == pytest.approx(3.0, abs=0.8)


def test_gps_jump_is_gated_then_believed() -> None:
    vehicle = standing()
    vehicle.run(2000)
    vehicle["fault_gps_offset_east"] = 40.0
    vehicle.run(2000)
    assert abs(vehicle["est_e"]) < 1.0
    assert vehicle["innovation_ratio"] > 0.8
    vehicle.run(4000)
    assert vehicle["est_e"] == pytest.approx(40.0, abs=1.5)


def test_barometer_drift_moves_the_height_and_its_loss_falls_back_on_gps() -> None:
    vehicle = standing()
    vehicle["fault_baro_drift"] = 0.5
    vehicle.run(8000)
    assert vehicle["altitude_est_m"] == pytest.approx(10.0, abs=1.5)
    vehicle["fault_baro_loss"] = 1.0
    vehicle.run(8000)
    assert vehicle["baro_ok"] == 0.0
    assert vehicle["height_from"] == 2.0
    assert vehicle["altitude_est_m"] == pytest.approx(0.0, abs=1.5)


def test_losing_the_gps_takes_the_position_away() -> None:
    vehicle = standing()
    vehicle.run(400)
    vehicle["fault_gps_loss"] = 1.0
    vehicle.run(800)
    assert vehicle["gps_ok"] == 0.0
    assert vehicle["position_ok"] == 0.0


def test_slots_are_the_same_memory_from_every_side() -> None:
    vehicle = standing()
    assert len(Vehicle.slots()) == len(set(Vehicle.slots().values()))
    vehicle["fault_gps_noise"], vehicle["motor_failed"] = 2.0, 3.0
    assert vehicle.sensors["fault_gps_noise"] == 2.0
    assert vehicle.world.state.motor_failed == 3.0
    assert vehicle.world["altitude_m"] == vehicle["altitude_m"]


def test_every_fault_of_the_sensors_has_a_parameter_and_a_name_all_autopilots_share() -> None:
    from saflite.flight.autopilots.reference.parameters import parameter_table
    from saflite.flight.autopilots.reference.sensor_faults import fault_value, shared_names

    names = shared_names()
    assert set(FAULTS) < set(names)
    for name, fault in FAULTS.items():
        row = parameter_table()[names[name]]
        assert row.default == pytest.approx(fault_value(name, fault.healthy))
        for size, limit in ((fault.low, row.low), (fault.high, row.high)):
            assert fault_value(name, size) == pytest.approx(limit, abs=1e-6), name
