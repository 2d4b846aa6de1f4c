/* A mission flown by a kinematic vehicle under the local planner, whole, in one call.
 *
 * The mission is rows of x, y, z (m): take-off point (z: height to climb to), way-points, landing point (z not used:
 * the landing leg is flown at the height of the leg before). Times, gains and limits follow seed-systems 3.6, 5.7. */
#ifndef SAFLITE_KINEMATIC_H
#define SAFLITE_KINEMATIC_H

#include <stdint.h>

enum {                          /* settings of the vehicle; defaults in flight/planner/settings.py */
    KINEMATIC_SET_START_DELAY,  /* on the ground before take-off, s */
    KINEMATIC_SET_CLIMB,        /* m/s */
    KINEMATIC_SET_POSITION_GAIN,  /* 1/s */
    KINEMATIC_SET_HEIGHT_GAIN,  /* 1/s */
    KINEMATIC_SET_SPEED_MAX,    /* m/s, in the plane */
    KINEMATIC_SET_UP_MAX,       /* m/s */
    KINEMATIC_SET_DOWN_MAX,     /* m/s */
    KINEMATIC_SET_ACCELERATION, /* m/s^2 */
    KINEMATIC_SET_JERK,         /* m/s^3 */
    KINEMATIC_SET_VELOCITY_TAU, /* s, velocity loop */
    KINEMATIC_SET_YAW_RATE,     /* deg/s */
    KINEMATIC_SET_YAW_GAIN,     /* 1/s */
    KINEMATIC_SET_ACCEPT,       /* way-point acceptance in the plane, m */
    KINEMATIC_SET_ACCEPT_Z,     /* and in height, m */
    KINEMATIC_SET_LAND_SPEED,   /* m/s below 5 m; 1 m/s at 10 m and above */
    KINEMATIC_SET_GROUND_TIME,  /* from touch-down to the end of the log, s */
    KINEMATIC_SET_CORE,         /* solid core of a box as a share of the seen box */
    KINEMATIC_SET_TIME_LIMIT,   /* s */
    KINEMATIC_SET_DRIFT,        /* sd of the slow error of the position estimate, m */
    KINEMATIC_SET_DRIFT_TAU,    /* s */
    KINEMATIC_SET_LATENCY,      /* from planning to flying, s, at most 1 */
    KINEMATIC_SET_JITTER,       /* chance that a plan is skipped */
    KINEMATIC_SET_START_YAW,    /* deg, compass */
    KINEMATIC_SET_TURN_LOCK,    /* 1 PX4's turning lock on, 0 off */
    KINEMATIC_SETTING_COUNT
};

enum { KINEMATIC_COMPLETED, KINEMATIC_CRASHED, KINEMATIC_TIMED_OUT };

enum {                          /* out[] of kinematic_fly, then one clearance per box */
    KINEMATIC_OUT_ENDING, KINEMATIC_OUT_DURATION, KINEMATIC_OUT_DISTANCE, KINEMATIC_OUT_ROWS, KINEMATIC_OUT_COUNT
};

#define KINEMATIC_STEP_S 0.05
#define KINEMATIC_TRACK_S 0.5
enum { KINEMATIC_TRACK_FIELDS = 5 };    /* t, x, y, z, yaw (rad) */

/* `state` is a planner's block (it is initialised here). `track` has room for `rows_max` rows. */
void kinematic_fly(void *state, const double *planner_settings, const double *settings, const double *mission, int n_mission,
                   const double *boxes, int n_boxes, uint64_t seed, double *track, int rows_max, double *out);

/* PX4's way-point progress with avoidance: 1 when the leg from -> goal counts as flown (seed-systems 5.7). `stuck_s`
 * is how long the height has not come nearer while the vehicle is within the acceptance radius. */
int mission_reached(const double from[3], const double goal[3], const double at[3], double accept_m, double accept_z_m,
                    double stuck_s);

#endif
