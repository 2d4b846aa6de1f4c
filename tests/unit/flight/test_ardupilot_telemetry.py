"""What ArduPilot says, under common names: messages as they come, one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from external_stand_ins import message

from saflite.flight.autopilots.ardupilot.telemetry import EKF_NEEDED, GEOFENCE, MODES, Telemetry
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external.telemetry import PREARM, TAKING_OFF, TEXT_CHARS_MAX, TEXTS_MAX

HOME = (47.3977419, 8.5455938, 488.79)
ARMED = 128


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(np.zeros((0, 8)), 0.0)


def test_what_the_vehicle_says_comes_under_common_names(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {"RTL_ALT": 1500.0}, HOME)
    for one in (
        message("HEARTBEAT", custom_mode=5, base_mode=128 + 1),
        message("EXTENDED_SYS_STATE", landed_state=2),
        message("GLOBAL_POSITION_INT", relative_alt=12_500, alt=501_290),
        message("LOCAL_POSITION_NED", x=3.0, y=4.0, vz=-1.0),
        message("GPS_RAW_INT", fix_type=6, satellites_visible=10, alt=508_790),
        message("SYS_STATUS", onboard_control_sensors_health=PREARM | 65536 | 8, voltage_battery=12_600),
        message("EKF_STATUS_REPORT", flags=EKF_NEEDED),
        message("PARAM_VALUE", param_id=b"RTL_ALT", param_value=2500.0, param_type=4),
        message("FENCE_STATUS", breach_status=1),
    ):
        told.take(one, 1.0)
    board = {
        name: vehicle[name] for name in ("mode", "armed", "landed", "taken_off", "gps_ok", "baro_ok", "rc_present")
    }
    assert board == {
        "mode": 5.0,
        "armed": 1.0,
        "landed": 0.0,
        "taken_off": 1.0,
        "gps_ok": 1.0,
        "baro_ok": 1.0,
        "rc_present": 1.0,
    }
    assert (vehicle["altitude_est_m"], vehicle["climb_est_mps"], vehicle["failsafe_fence"]) == pytest.approx(
        (12.5, 1.0, 1.0)
    )
    assert vehicle["gps_altitude_m"] == pytest.approx(20.0)
    assert vehicle["rtl_altitude_set_m"] == 25.0
    assert told.ready


def test_an_autopilot_that_talks_without_end_fills_no_memory(vehicle: Vehicle) -> None:
    """The rest of a text was put to it again and again: 60,000 took a minute, and nobody could read the trace."""
    told = Telemetry(vehicle, {}, HOME)
    for number in range(2_000):
        told.take(message("STATUSTEXT", severity=6, text=b"x" * 50, id=1, chunk_seq=number % 256), 1.0)
    assert max(len(one.text) for one in told.texts) < TEXT_CHARS_MAX + 50
    for number in range(TEXTS_MAX + 10):
        told.take(message("STATUSTEXT", severity=6, text=b"%d" % number), 1.0)
    told.take(message("STATUSTEXT", severity=3, text=b"Radio Failsafe"), 1.0)
    assert len(told.texts) == TEXTS_MAX
    assert told.texts[-1].text == "Radio Failsafe"
    assert vehicle["failsafe_radio"] == 1.0


def test_texts_raise_and_clear_failsafes(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {}, HOME)
    told.zero_s = 10.0
    told.take(message("STATUSTEXT", severity=4, text=b"Radio Failsafe"), 12.0)
    assert vehicle["failsafe_radio"] == 1.0
    assert (told.texts[0].at_s, told.texts[0].severity) == (2.0, "warning")
    told.take(message("STATUSTEXT", severity=4, text=b"Radio Failsafe Cleared"), 13.0)
    assert vehicle["failsafe_radio"] == 0.0


def test_a_text_that_tells_of_two_failsafes_raises_both(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {}, HOME)
    told.take(message("STATUSTEXT", severity=4, text=b"Radio + Battery Failsafe - Continuing Landing"), 1.0)
    assert (vehicle["failsafe_radio"], vehicle["failsafe_battery"], vehicle["failsafe_gps"]) == (1.0, 1.0, 0.0)
    told.take(message("STATUSTEXT", severity=2, text=b"EKF Failsafe: changed to LAND Mode"), 2.0)
    told.take(message("STATUSTEXT", severity=4, text=b"Radio Failsafe Cleared"), 3.0)
    assert (vehicle["failsafe_radio"], vehicle["failsafe_battery"], vehicle["failsafe_gps"]) == (0.0, 1.0, 1.0)
    told.take(message("STATUSTEXT", severity=4, text=b"GCS Failsafe"), 4.0)
    assert vehicle["failsafe_radio"] == 0.0


def test_heights_count_from_home_as_it_was_at_take_off(vehicle: Vehicle) -> None:
    parameters = {"RTL_ALT": 1500.0, "RTL_ALT_FINAL": 0.0, "FENCE_ALT_MAX": 100.0}
    told = Telemetry(vehicle, parameters, HOME)
    told.take(message("GLOBAL_POSITION_INT", alt=489_000, relative_alt=0), 1.0)
    told.take(message("HEARTBEAT", base_mode=ARMED), 2.0)
    told.take(message("EXTENDED_SYS_STATE", landed_state=2), 2.0)
    told.take(message("GLOBAL_POSITION_INT", alt=519_000, relative_alt=30_000), 3.0)
    assert vehicle["altitude_est_m"] == pytest.approx(30.0)
    told.take(message("GLOBAL_POSITION_INT", alt=519_000, relative_alt=0), 4.0)  # home was set here
    assert vehicle["altitude_est_m"] == pytest.approx(30.0)
    heights = [vehicle[f"{name}_set_m"] for name in ("rtl_altitude", "rtl_altitude_final", "fence_altitude_max")]
    assert heights == pytest.approx([45.0, 0.0, 130.0])
    told.take(message("PARAM_VALUE", param_id=b"RTL_ALT", param_value=2000.0), 5.0)
    assert vehicle["rtl_altitude_set_m"] == pytest.approx(50.0)


def test_places_do_not_count_from_where_the_vehicle_was_armed(vehicle: Vehicle) -> None:
    """Copter 4.1-dev tells local places from home, which moves as the vehicle is armed; 4.5 from a fixed origin."""

    def places(x: float, lat: float) -> tuple[float, float]:
        told.take(message("LOCAL_POSITION_NED", x=x), 1.0)
        first = vehicle["x_est_m"]
        told.take(message("GLOBAL_POSITION_INT", lat=round(lat * 1e7), lon=round(HOME[1] * 1e7)), 1.0)
        told.take(message("LOCAL_POSITION_NED", x=x), 1.04)
        return first, vehicle["x_est_m"]

    told, metre = Telemetry(vehicle, {}, HOME), 1.0 / 111_195.0
    assert places(0.0, HOME[0]) == (0.0, 0.0)
    places(20.0, HOME[0] + 20.0 * metre)
    assert places(22.0, HOME[0] + 22.0 * metre) == pytest.approx((22.0, 22.0), abs=0.1)
    assert places(0.0, HOME[0] + 22.0 * metre) == pytest.approx((22.0, 22.0), abs=0.1), "only home moved"
    assert places(1.0, HOME[0] + 23.0 * metre) == pytest.approx((23.0, 23.0), abs=0.1)
    assert places(31.0, HOME[0] + 53.0 * metre) == pytest.approx((23.0, 53.0), abs=0.1), "a false position"


def test_a_fence_that_a_command_switched_off_is_off(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0}, HOME)
    told.tick()
    assert (vehicle["fence_on_set"], vehicle["fence_enabled"]) == (1.0, 1.0)
    told.take(message("SYS_STATUS", onboard_control_sensors_enabled=0), 1.0)
    told.tick()
    assert (vehicle["fence_on_set"], vehicle["fence_enabled"]) == (0.0, 0.0)
    told.take(message("SYS_STATUS", onboard_control_sensors_enabled=GEOFENCE), 2.0)
    told.take(message("PARAM_VALUE", param_id=b"FENCE_TYPE", param_value=6.0), 2.0)
    told.tick()
    assert (vehicle["fence_on_set"], vehicle["fence_enabled"]) == (1.0, 0.0)  # on, but without a ceiling
    told.take(message("PARAM_VALUE", param_id=b"FENCE_ACTION", param_value=0.0), 3.0)
    told.take(message("SYS_STATUS", onboard_control_sensors_enabled=0), 3.0)
    told.tick()
    assert vehicle["fence_on_set"] == 1.0  # told as off where it only reports


def test_only_an_ordered_take_off_has_a_height_to_reach(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {}, HOME)
    for mode, takeoff in (("ALT_HOLD", 0.0), ("GUIDED", 1.0), ("LOITER", 0.0), ("AUTO", 1.0)):
        told.take(message("HEARTBEAT", custom_mode=MODES[mode], base_mode=ARMED), 1.0)
        told.take(message("EXTENDED_SYS_STATE", landed_state=TAKING_OFF), 1.0)
        told.tick()
        assert vehicle["takeoff"] == takeoff, mode


def test_a_long_text_in_pieces_is_one(vehicle: Vehicle) -> None:
    told = Telemetry(vehicle, {}, HOME)
    first, rest = b"Preflight Fail: heading estimate not stable, wait ", b"until it is\t"
    told.take(message("STATUSTEXT", severity=4, id=7, chunk_seq=0, text=first), 1.0)
    told.take(message("STATUSTEXT", severity=4, id=7, chunk_seq=1, text=rest), 1.0)
    told.take(message("STATUSTEXT", severity=4, text=b" Radio Failsafe "), 2.0)
    assert [one.text for one in told.texts] == [(first + rest).decode().strip(), "Radio Failsafe"]


def test_a_build_that_tells_of_no_ekf_failsafe_tells_it_by_what_it_says_before(vehicle: Vehicle) -> None:
    """4.1 changes the mode and says "EKF variance" only; what ends it is told by no text at all."""
    told = Telemetry(vehicle, {"FS_EKF_THRESH": 0.8, "FS_EKF_ACTION": 1.0}, HOME)
    told.tells_ekf = False
    variance = message("STATUSTEXT", severity=2, text=b"EKF variance")
    bad = message("EKF_STATUS_REPORT", flags=EKF_NEEDED, velocity_variance=1.2, compass_variance=0.9)
    good = message("EKF_STATUS_REPORT", flags=EKF_NEEDED, velocity_variance=0.1, compass_variance=0.1)
    told.take(message("HEARTBEAT", custom_mode=MODES["ALT_HOLD"], base_mode=ARMED + 1), 1.0)
    told.take(variance, 1.1)
    assert vehicle["failsafe_gps"] == 0.0, "a mode that needs no position stays"
    told.take(message("HEARTBEAT", custom_mode=MODES["GUIDED"], base_mode=ARMED + 1), 2.0)
    told.take(variance, 2.1)
    assert vehicle["failsafe_gps"] == 1.0
    for _ in range(20):
        told.take(bad, 3.0)
        told.take(good, 3.1)
    assert vehicle["failsafe_gps"] == 1.0
    for _ in range(6):
        told.take(good, 4.0)
    assert vehicle["failsafe_gps"] == 0.0
    told.tells_ekf = True
    told.take(variance, 5.0)
    assert vehicle["failsafe_gps"] == 0.0, "a build that tells of it says so itself"
