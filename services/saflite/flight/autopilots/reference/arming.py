"""Checks before arming (ArduCopter's AP_Arming, the part that can fail here)."""

from __future__ import annotations

from saflite.flight.autopilots.reference.flight_stack import FlightStack

GYRO_CALM_RPS, LEAN_MAX_RAD, HEIGHTS_APART_M, FIELD_GAUSS = 0.35, 0.6, 15.0, (0.25, 0.9)


def why_not(ap: FlightStack) -> str:
    """Return why the vehicle may not be armed, empty if it may."""
    board, p = ap.board, ap.parameters
    if ap.parachute.released:
        return "parachute released"
    if not ap.mode.may_arm():
        return f"mode {ap.mode.name} not armable"
    if p["ARMING_CHECK"] == 0:
        return ""
    gyro = max(abs(board[f"gyro_{axis}_rps"] - board[f"cal_gyr_{axis}"]) for axis in "xyz")
    field = sum((board[f"compass_{axis}_gauss"] + board[f"cal_mag_{axis}"]) ** 2 for axis in "xyz") ** 0.5
    apart_m = abs(board["baro_altitude_m"] + board["baro_ground_m"] - board["gps_up_m"])
    rules = (
        (ap.mode.needs_position and board["position_ok"] == 0.0, "need position estimate"),
        (ap.mode.needs_position and board["gps_ok"] == 0.0, "GPS: no fix"),
        (board["baro_ok"] == 0.0, "barometer not healthy"),
        (gyro > GYRO_CALM_RPS, "gyros not calibrated"),
        (abs(board["est_roll"]) + abs(board["est_pitch"]) > LEAN_MAX_RAD, "leaning"),
        (
            p["COMPASS_USE"] != 0 and not FIELD_GAUSS[0] < field < FIELD_GAUSS[1],
            f"check compass field {field:.2f} Gauss",
        ),
        (board["gps_ok"] != 0.0 and apart_m > HEIGHTS_APART_M, f"GPS and barometer differ by {apart_m:.0f} m"),
        (ap.failsafes.radio and p["FS_THR_ENABLE"] != 0, "throttle below failsafe"),
        (ap.failsafes.battery, "battery failsafe"),
        (bool(p["FENCE_ENABLE"]) and ap.failsafes.fence, "vehicle outside fence"),
        (ap.radio.throttle_high() and not ap.mode.autonomous, "throttle too high"),
    )
    return next((text for bad, text in rules if bad), "")
