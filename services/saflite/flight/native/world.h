/* The physical world, alone: a quadrotor on JSBSim among boxes, stepped by four throttles. Knows no sensor and no
 * autopilot; whatever flies (native code of ours, a bridge to another process) calls `world_step` once per step.
 *
 * `World.at[]` is the truth: one double per name below, mapped into Python under the same names. Frames: x north, y east,
 * altitude and climb up, from the take-off point; body axes forward, right, down.
 */
#ifndef SAFLITE_WORLD_H
#define SAFLITE_WORLD_H

#include <stddef.h>
#include <stdint.h>

#define STEP_S 0.0025
#define GRAVITY 9.80665
#define PI 3.14159265358979323846
#define MOTORS 4

/* Fresh at every step: body rates and what an accelerometer in the centre of gravity feels. */
#define WORLD_RATES(X) \
    X(roll_rate_rps) X(pitch_rate_rps) X(yaw_rate_rps) X(force_x_mps2) X(force_y_mps2) X(force_z_mps2)

/* Fresh every `steps_per_state` steps, as JSBSim gives it. */
#define WORLD_STATE(X) \
    X(x_m) X(y_m) X(altitude_m) X(vx_mps) X(vy_mps) X(climb_mps) X(roll_rad) X(pitch_rad) X(yaw_rad)

/* Told from it for traces, by the names of contract/signals.py; obstacle distance as the competition measures it. */
#define WORLD_TOLD(X) \
    X(time_s) X(roll_deg) X(pitch_deg) X(yaw_deg) X(roll_rate_dps) X(pitch_rate_dps) X(yaw_rate_dps) \
    X(obstacle_distance_m) X(contact) X(world_state)

/* What the vehicle does to the world: throttles 0..1 as commanded and as the motors follow, a motor (1 to 4) that keeps
 * only a share of its command, whether the parachute was released (touching down then stops the world unharmed). */
#define WORLD_ACTUATORS(X) \
    X(command_1) X(command_2) X(command_3) X(command_4) X(motor_1) X(motor_2) X(motor_3) X(motor_4) \
    X(motor_failed) X(motor_failed_share) X(chute_released)

#define WORLD_SLOTS(X) WORLD_RATES(X) WORLD_STATE(X) WORLD_TOLD(X) WORLD_ACTUATORS(X) X(step)

#define WORLD_ENUM(name) WORLD_##name,
enum { WORLD_SLOTS(WORLD_ENUM) WORLD_SLOT_COUNT };
#undef WORLD_ENUM

/* Motors off on the ground nothing moves, and JSBSim is not stepped; neither is it after a crash or under the chute. */
enum { WORLD_STANDING = 0, WORLD_FLYING = 1, WORLD_CRASHED = 2, WORLD_FROZEN = 3 };

typedef struct PyObject PyObject;

typedef struct {
    double at[WORLD_SLOT_COUNT];
    const double *boxes; /* rows as boxes.h has them */
    int32_t box_count, steps_per_state;
    double origin_m;     /* JSBSim's height reading at the take-off point */
    double last_m, last_sink_mps; /* altitude and sink rate of the state before, while flying */
    PyObject *run;       /* steps JSBSim */
    PyObject *const *nodes; /* getters of rates and state, setters of the motors */
} World;

/* All functions that return int give 0, or -1 with a Python error set; the caller holds the interpreter lock. */
void world_start(World *w, const double *boxes, int box_count, int steps_per_state);
void world_connect(World *w, PyObject *run, PyObject *const *nodes, double origin_m);
int world_read(World *w);                                     /* all truth anew, without stepping */
int world_step(World *w, const double throttles[MOTORS]);     /* actuate, then advance; the first throttle lifts off */
int world_actuate(World *w, const double throttles[MOTORS]);  /* what the motors do from now on */
int world_advance(World *w);                                  /* one step of physics with the motors as they are */
void world_follow(World *w);                                  /* another's physics wrote the truth: what follows from it */

/* JSBSim behind CPython (jsbsim.c). */
int jsbsim_run(World *w);
int jsbsim_read_rates(World *w);
int jsbsim_read_state(World *w);
int jsbsim_write_motors(World *w);

static inline double clamp(double value, double low, double high)
{
    return value < low ? low : (value > high ? high : value);
}

#endif
