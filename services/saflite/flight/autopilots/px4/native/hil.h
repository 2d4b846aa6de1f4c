/* The world's side of a flight with PX4, over the simulator's MAVLink interface: sensors to it over TCP every 5 ms, motor
 * commands back, and no line of Python in between. PX4's clock is the time of the sensors, so between two calls it waits
 * for us; what it says to its ground station over UDP is read in the same loop.
 */
#ifndef SAFLITE_PX4_HIL_H
#define SAFLITE_PX4_HIL_H

#include "recorder.h"
#include "sensors.h"
#include "world.h"

/* What it says of itself over MAVLink, and settings in force: Python writes them, the trace takes them. */
#define PX4_TOLD(X) \
    X(mode) X(armed) X(landed) X(takeoff) X(taken_off) X(mission_item) X(mission_count) \
    X(x_est_m) X(y_est_m) X(altitude_est_m) X(climb_est_mps) X(altitude_target_m) X(home_distance_m) \
    X(gps_altitude_m) X(gps_ok) X(baro_ok) X(battery_v) X(rc1_pwm) X(rc2_pwm) X(rc3_pwm) X(rc4_pwm) X(rc_present) \
    X(failsafe_gps) X(failsafe_radio) X(failsafe_battery) X(failsafe_fence)

#define PX4_SETTINGS(X) \
    X(rtl_altitude_set_m) X(rtl_descend_altitude_set_m) X(rtl_altitude_final_set_m) X(hold_altitude_min_set_m) \
    X(takeoff_altitude_set_m) X(takeoff_slow_set_m) \
    X(takeoff_speed_set_mps) X(land_speed_set_mps) X(land_speed_high_set_mps) \
    X(land_altitude_low_set_m) X(pilot_speed_up_set_mps) X(pilot_speed_down_set_mps) X(cruise_speed_set_mps) \
    X(return_speed_set_mps) X(loiter_speed_set_mps) X(angle_max_set_deg) X(disarm_delay_set_s) X(fence_enabled) \
    X(acceleration_set_mps2) X(fence_on_set) X(fence_type_set) X(fence_action_set) X(fence_altitude_max_set_m) \
    X(fence_radius_set_m) X(fs_gps_action) X(fs_gps_delay_set_s) X(fs_throttle_set_pwm) X(fs_throttle_enabled) \
    X(arming_checks_set) X(altitude_source) X(descent_speed_set_mps) X(trim_roll_set_deg) X(trim_pitch_set_deg) \
    X(fs_action_delay_set_s)

/* The radio: pulses of its channels, whether it is silent; and the mean of the motor commands. */
#define PX4_RADIO(X) \
    X(rc_1) X(rc_2) X(rc_3) X(rc_4) X(rc_5) X(rc_6) X(rc_7) X(rc_8) X(rc_silent) X(throttle)

#define PX4_SLOTS(X) PX4_TOLD(X) PX4_SETTINGS(X) PX4_RADIO(X)

#define PX4_ENUM(name) P_##name,
enum { PX4_SLOTS(PX4_ENUM) PX4_SLOT_COUNT };
#undef PX4_ENUM

enum { PX4_OK = 0, PX4_GONE = 1, PX4_SILENT = 2, PX4_ALIEN = 3, PX4_PYTHON = -1 };
enum { PX4_SAID_MAX = 1 << 20, PX4_BUFFER = 8192, FRAME_MAX = 280 };
enum { RC_CHANNELS_SENT = 8 };

typedef struct {
    World world;
    Sensors sensors;
    double at[PX4_SLOT_COUNT];
    Recorder recorder;
    double home[3];          /* degrees, degrees, metres above sea */
    double throttles[MOTORS];
    uint64_t answered_us;    /* time of the last motor commands */
    int32_t tcp, udp, silent_ms, in_row, quiet; /* messages answered in a row, up to some; without a word on any link */
    int32_t own_physics;     /* PX4's, run step by step through the gate of `preload/gate.c`, which `tcp` then is */
    uint32_t held_bytes, said_bytes;
    uint8_t sequence, armed;
    uint8_t held[PX4_BUFFER]; /* of the TCP link, not yet a whole message */
    uint8_t said[PX4_SAID_MAX]; /* MAVLink of the ground station's link that waits for Python */
} Px4;

/* packets.c: the three messages to PX4, each into a frame of MAVLink 2; and the one from it. */
int hil_sensor(const Px4 *p, uint64_t time_us, int pressure_too, int compass_too, uint8_t frame[FRAME_MAX]);
int hil_gps(const Px4 *p, uint64_t time_us, uint8_t frame[FRAME_MAX]);
int hil_radio(const Px4 *p, uint64_t time_us, uint8_t frame[FRAME_MAX]);
int hil_take(Px4 *p, const uint8_t *data, int bytes); /* returns how many bytes are done with */

#endif
