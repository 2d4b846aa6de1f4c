/* The world's side of a flight with a firmware in another process: world, sensors, radio, telemetry and trace, with one
 * message each way per step of 2.5 ms and no line of Python in between.
 */
#ifndef SAFLITE_BETAFLIGHT_BRIDGE_H
#define SAFLITE_BETAFLIGHT_BRIDGE_H

#include "link.h"
#include "recorder.h"
#include "sensors.h"
#include "world.h"

/* What the pilot's side does. Pulses in the firmware's channel order: roll, pitch, throttle, yaw, switches.
 * `rc_link`: how they travel: 0 not at all, 1 as messages of the serial link, 2 as the simulator's own packets. */
#define BRIDGE_RADIO(X) \
    X(rc_1) X(rc_2) X(rc_3) X(rc_4) X(rc_5) X(rc_6) X(rc_7) X(rc_8) X(rc_9) X(rc_10) X(rc_11) X(rc_12) \
    X(rc_13) X(rc_14) X(rc_15) X(rc_16) X(rc_link)

/* Faults beyond those of flight/sensors: of what is sent to the firmware, and of what its motors do. */
#define BRIDGE_FAULTS(X) \
    X(gyro_stuck) X(gyro_limit_dps) X(accelerometer_stuck) X(gps_drift_north) X(gps_drift_east) X(gps_frozen) \
    X(motor_swap) X(motor_lag_s)

/* What the firmware says of itself over its telemetry; the last word stays. */
#define BRIDGE_TOLD(X) \
    X(armed) X(mode) X(box_angle) X(box_horizon) X(box_altitude_hold) X(box_position_hold) X(box_rescue) \
    X(failsafe_radio) X(arming_flags) X(arming_forbidden) X(runaway_stopped) X(crash_stopped) X(altitude_est_m) X(climb_est_mps) \
    X(rx_roll_us) X(rx_pitch_us) X(rx_throttle_us) X(rx_yaw_us) X(telemetry_age_s)

/* Made for the trace. */
#define BRIDGE_SHOWN(X) \
    X(rc_present) X(rc_valid) X(arm_switch) X(failsafe_switch) X(rescue_switch) X(throttle) X(home_distance_m) X(gps_altitude_m) X(baro_altitude_m) X(firmware_s) X(landed)

/* Settings the flight began with, for policies: Python writes them. */
#define BRIDGE_SETTINGS(X) \
    X(angle_limit_set_deg) X(failsafe_delay_set_s) X(failsafe_recovery_set_s) X(failsafe_procedure) \
    X(failsafe_switch_mode) X(failsafe_landing_set_s) X(auto_disarm_set_s) X(rescue_sanity_checks) \
    X(rescue_descend_set_mps) X(rescue_angle_set_deg) X(rx_min_set_us) X(rx_max_set_us) X(runaway_prevention_set) \
    X(runaway_throttle_set_percent) X(crash_recovery_set) X(settings_lost) X(height_tune_usual) X(race_mode_set)

#define BRIDGE_SLOTS(X) BRIDGE_RADIO(X) BRIDGE_FAULTS(X) BRIDGE_TOLD(X) BRIDGE_SHOWN(X) BRIDGE_SETTINGS(X)

#define BRIDGE_ENUM(name) B_##name,
enum { BRIDGE_SLOTS(BRIDGE_ENUM) BRIDGE_SLOT_COUNT };
#undef BRIDGE_ENUM

/* Boxes whose places in the status message Python looks up once: arm and those of BRIDGE_TOLD, in this order. */
enum { BOX_ARM, BOX_ANGLE, BOX_HORIZON, BOX_ALTITUDE_HOLD, BOX_POSITION_HOLD, BOX_RESCUE, BOX_FAILSAFE, BOX_COUNT };

enum { BRIDGE_OK = 0, BRIDGE_GONE = 1, BRIDGE_SILENT = 2, BRIDGE_EXITED = 3, BRIDGE_PYTHON = -1 };
enum { PORT_PILOT = 0, PORT_TELEMETRY = 1, PORT_TEST = 2 };
enum { SAID_MAX = 262144, PENDING_MAX = 65536, MSP_PAYLOAD_MAX = 255 };

typedef struct {
    uint8_t payload[MSP_PAYLOAD_MAX];
    int32_t state, size, command, count;
    uint8_t sum;
} MspReader;

typedef struct {
    World world;
    Sensors sensors;
    double at[BRIDGE_SLOT_COUNT];
    double gyro_held[3], acc_held[3], gps_held[6], gps_drifted_m[2], lag[MOTORS], pressure_pa;
    double trim_us;        /* of the pilot's throttle */
    double rescue_asked_s; /* how long a rescue may still be the pilot's after its switch */
    Recorder recorder;
    int32_t box_bits[BOX_COUNT];
    int32_t fd, listening, polls, firmware_code, firmware_pid, motor_messages;
    int32_t gyro_is_held, acc_is_held, gps_is_held, stepped;
    MspReader reader;
    LinkDown down;
    LinkUp up;
    uint8_t pending[LINK_PORTS][PENDING_MAX], said[LINK_PORTS][SAID_MAX];
    int32_t pending_bytes[LINK_PORTS], said_bytes[LINK_PORTS];
} Bridge;

#define AT(name) (b->at[B_##name])
#define TRUTH(name) (b->world.at[WORLD_##name])
#define READING(name) (b->sensors.at[SENSOR_##name])

int bridge_run(Bridge *b, int steps);

/* packets.c: what the firmware is given of the world. */
void packet_state(Bridge *b, double state[LINK_STATE]);
void packet_motors(Bridge *b, const float said[LINK_MOTORS], double throttles[MOTORS]);

/* telemetry.c: MSP version 1, polled and read. */
int msp_frame(uint8_t *into, int command, const uint8_t *payload, int size);
void telemetry_poll(Bridge *b);
void telemetry_read(Bridge *b, const uint8_t *bytes, int count);

#endif
