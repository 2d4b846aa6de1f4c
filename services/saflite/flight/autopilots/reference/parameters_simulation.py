"""Parameters of the world (`SIM_*`): sensor faults, wind, engine, radio. ArduPilot SITL's names and units."""

from __future__ import annotations

from saflite.flight.autopilots.reference.parameter import Parameter as Row


def _axes(
    name: str, slot: str, low: float, high: float, unit: str, meaning: str, scale: float = 1.0
) -> tuple[Row, ...]:
    return tuple(
        Row(f"{name}_{axis}", 0, low, high, unit, f"{meaning}, {axis}", f"{slot}_{axis.lower()}", scale)
        for axis in "XYZ"
    )


ROWS: tuple[Row, ...] = (
    Row("SIM_GPS_DISABLE", 0, 0, 1, "", "GPS receiver silent", "fault_gps_loss"),
    Row("SIM_GPS_NUMSATS", 10, 0, 14, "", "satellites in view", "fault_gps_satellites"),
    Row("SIM_GPS_NOISE", 0, 0, 10, "m", "noise added to GPS", "fault_gps_noise"),
    Row("SIM_GPS_GLITCH_X", 0, -100, 100, "m", "GPS offset north", "fault_gps_offset_north"),
    Row("SIM_GPS_GLITCH_Y", 0, -100, 100, "m", "GPS offset east", "fault_gps_offset_east"),
    Row("SIM_GPS_GLITCH_Z", 0, -100, 100, "m", "GPS offset up", "fault_gps_offset_up"),
    Row("SIM_GPS_DRIFTALT", 0, -5, 5, "m/s", "GPS height drift", "fault_gps_height_drift"),
    Row("SIM_BARO_DISABLE", 0, 0, 1, "", "barometer silent", "fault_baro_loss"),
    Row("SIM_BARO_GLITCH", 0, -100, 100, "m", "barometer offset", "fault_baro_offset"),
    Row("SIM_BARO_DRIFT", 0, -5, 5, "m/s", "barometer drift", "fault_baro_drift"),
    Row("SIM_BARO_RND", 0, 0, 5, "m", "noise added to the barometer", "fault_baro_noise"),
    Row("SIM_MAG_RND", 0, 0, 0.5, "Gauss", "noise added to the compass", "fault_compass_noise"),
    *_axes("SIM_MAG_OFFSET", "fault_compass_offset", -500, 500, "mGauss", "compass offset", 0.001),
    Row("SIM_GYR_RND", 0, 0, 30, "deg/s", "noise added to the gyros", "fault_gyro_noise", 0.01745329251994),
    *_axes("SIM_GYR_BIAS", "fault_gyro_offset", -0.2, 0.2, "rad/s", "gyro offset"),
    Row("SIM_ACC_RND", 0, 0, 5, "m/s/s", "noise added to the accelerometers", "fault_accelerometer_noise"),
    *_axes("SIM_ACC_BIAS", "fault_accelerometer_offset", -3, 3, "m/s/s", "accelerometer offset"),
    Row("SIM_BATT_VOLTAGE", 0, 0, 17, "V", "battery voltage, 0 takes the model's", "fault_battery_voltage"),
    Row("SIM_ENGINE_FAIL", 0, 0, 4, "", "motor that fails, 0 none", "motor_failed"),
    Row("SIM_ENGINE_MUL", 1, 0, 1, "", "output left to the failed motor", "motor_failed_share"),
    Row("SIM_WIND_SPD", 0, 0, 15, "m/s", "wind speed, 0 takes the scenario's"),
    Row("SIM_WIND_DIR", 180, 0, 360, "deg", "direction the wind comes from"),
    Row("SIM_WIND_TURB", 0, 0, 5, "m/s", "gusts on top of the wind"),
    Row("SIM_RC_FAIL", 0, 0, 2, "", "radio: 1 no pulses, 2 throttle below the failsafe value"),
    Row("SIM_PARA_ENABLE", 1, 0, 1, "", "parachute present in the world"),
)
