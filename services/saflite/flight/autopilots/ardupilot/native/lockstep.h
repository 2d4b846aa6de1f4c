/* The world's side of a flight with ArduPilot, over the JSON backend of its simulator build: one datagram each way per
 * step of 2.5 ms and no line of Python in between. Between two calls the autopilot waits for our word, so whatever is
 * written to its other links then arrives at one moment of simulated time.
 */
#ifndef SAFLITE_ARDUPILOT_LOCKSTEP_H
#define SAFLITE_ARDUPILOT_LOCKSTEP_H

#include "recorder.h"
#include "world.h"

/* What the autopilot says of itself over MAVLink, and settings in force: Python writes them, the trace takes them. */
#define LOCKSTEP_TOLD(X) \
    X(mode) X(armed) X(landed) X(takeoff) X(taken_off) X(throttle) X(mission_item) X(mission_count) \
    X(x_est_m) X(y_est_m) X(altitude_est_m) X(climb_est_mps) X(altitude_target_m) X(home_distance_m) \
    X(gps_altitude_m) X(gps_satellites) X(gps_ok) X(baro_ok) X(battery_v) \
    X(rc1_pwm) X(rc2_pwm) X(rc3_pwm) X(rc4_pwm) X(rc_present) \
    X(failsafe_gps) X(failsafe_radio) X(failsafe_battery) X(failsafe_fence) \
    X(circle_radius_m) X(circle_rate_dps) X(altitude_source)

#define LOCKSTEP_SETTINGS(X) \
    X(rtl_altitude_set_m) X(rtl_altitude_final_set_m) X(land_speed_set_mps) X(land_speed_high_set_mps) \
    X(land_altitude_low_set_m) X(pilot_speed_up_set_mps) X(pilot_speed_down_set_mps) X(takeoff_speed_set_mps) \
    X(takeoff_altitude_set_m) X(chute_altitude_min_set_m) X(fs_throttle_set_pwm) X(fs_throttle_enabled) \
    X(fs_gps_action) X(fence_enabled) X(fence_altitude_max_set_m) X(fence_action_set) X(fence_on_set) X(fence_type_set) \
    X(fence_radius_set_m) X(battery_low_set_v) X(battery_timer_set_s) X(battery_low_action_set) X(failsafe_options_set) \
    X(battery_critical_set_v) X(battery_low_charge_set_mah) X(arming_checks_set) X(angle_max_set_deg) \
    X(cruise_speed_set_mps) X(return_speed_set_mps) X(return_climb_min_set_m) X(loiter_speed_set_mps) \
    X(disarm_delay_set_s) X(circle_radius_set_m) X(descent_speed_set_mps) X(trim_roll_set_deg) X(trim_pitch_set_deg) \
    X(circle_rate_set_dps) X(acceleration_set_mps2) X(battery_capacity_set_mah) X(waypoint_radius_set_m) \
    X(circle_options_set) X(auto_options_set) X(pilot_turn_speed_set_dps)

#define LOCKSTEP_SLOTS(X) LOCKSTEP_TOLD(X) LOCKSTEP_SETTINGS(X)

#define LOCKSTEP_ENUM(name) L_##name,
enum { LOCKSTEP_SLOTS(LOCKSTEP_ENUM) LOCKSTEP_SLOT_COUNT };
#undef LOCKSTEP_ENUM

enum { LOCKSTEP_OK = 0, LOCKSTEP_GONE = 1, LOCKSTEP_SILENT = 2, LOCKSTEP_ALIEN = 3, LOCKSTEP_PYTHON = -1 };
enum { SAID_MAX = 1 << 20, STATE_LINE_MAX = 640 };

typedef struct {
    World world;
    double at[LOCKSTEP_SLOT_COUNT];
    Recorder recorder;
    int32_t udp, tcp, silent_ms, heard_one;
    int32_t own_physics;     /* the autopilot's, run frame by frame through the gate of `preload/gate.c` */
    uint32_t frame;          /* of the last packet taken */
    uint32_t said_bytes;
    double throttles[MOTORS];
    uint8_t peer[32];        /* sockaddr of the autopilot's end */
    uint32_t peer_bytes;
    uint8_t said[SAID_MAX];  /* MAVLink that waits for Python */
} Lockstep;

/* packets.c: layouts of the JSON backend (libraries/SITL of ArduPilot documents them for other simulators). */
int servo_packet(const uint8_t *data, int bytes, uint32_t *frame, double throttles[MOTORS]);
int state_line(const World *w, char *into, int room);

int lockstep_await(Lockstep *l);
int lockstep_run(Lockstep *l, int steps);

#endif
