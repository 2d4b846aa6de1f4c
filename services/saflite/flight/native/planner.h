/* Local obstacle planner after PX4-Avoidance's `local_planner` (master), compiled and deterministic.
 *
 * Frame: x north, y east, z up, metres from the take-off point; yaw in radians, compass sense (0 north, pi/2 east).
 * The state is one opaque block of `planner_state_size()` bytes (8-byte aligned) owned by the caller; nothing is
 * allocated and there are no globals, so any number of planners may live side by side.
 *
 * Use: planner_init once with PLANNER_SETTING_COUNT doubles, then planner_step at 10 Hz (up to 20 Hz) while the
 * vehicle is in the air. The planner looks through its camera and plans by itself every `plan_period_s`. The caller
 * flies to the position and yaw set-point; horizontal velocity is `position gain x (set-point - position)`.
 * Boxes: rows of eight doubles, see boxes.h. */
#ifndef SAFLITE_PLANNER_H
#define SAFLITE_PLANNER_H

#include <stddef.h>

enum {                    /* in[] of planner_step */
    PLANNER_IN_TIME,      /* s since any fixed moment */
    PLANNER_IN_X, PLANNER_IN_Y, PLANNER_IN_Z,       /* estimated position, m */
    PLANNER_IN_VX, PLANNER_IN_VY, PLANNER_IN_VZ,    /* estimated velocity, m/s */
    PLANNER_IN_YAW,       /* estimated yaw, rad */
    PLANNER_IN_GOAL_X, PLANNER_IN_GOAL_Y, PLANNER_IN_GOAL_Z,    /* way-point in force, m */
    PLANNER_IN_FROM_X, PLANNER_IN_FROM_Y, PLANNER_IN_FROM_Z,    /* the goal before it, m */
    PLANNER_IN_TRUE_X, PLANNER_IN_TRUE_Y, PLANNER_IN_TRUE_Z,    /* where the camera really is, m */
    PLANNER_IN_COUNT
};

enum {                    /* out[] of planner_step */
    PLANNER_OUT_X, PLANNER_OUT_Y, PLANNER_OUT_Z,    /* position set-point, m, in the estimate's frame */
    PLANNER_OUT_YAW,      /* yaw set-point, rad, -pi..pi */
    PLANNER_OUT_SPEED,    /* how far ahead the set-point is, m (the planner's speed factor times look-ahead) */
    PLANNER_OUT_STATE,    /* 0 following a path, 1 straight to the goal, 2 at the goal */
    PLANNER_OUT_POINTS,   /* points remembered */
    PLANNER_OUT_PATH,     /* nodes of the path in force */
    PLANNER_OUT_COUNT
};

enum {                    /* settings[] of planner_init; defaults in flight/planner/settings.py */
    PLANNER_SET_RANGE,            /* farthest point used, m */
    PLANNER_SET_NEAR,             /* nearest point seen, m */
    PLANNER_SET_FOV_H,            /* camera, deg */
    PLANNER_SET_FOV_V,            /* camera, deg */
    PLANNER_SET_COLUMNS,          /* rays across, at most 64 */
    PLANNER_SET_ROWS,             /* rays up and down, at most 48 */
    PLANNER_SET_MEMORY_AGE,       /* s */
    PLANNER_SET_PITCH_COST,
    PLANNER_SET_YAW_COST,
    PLANNER_SET_VELOCITY_COST,
    PLANNER_SET_OBSTACLE_KNEE,    /* m */
    PLANNER_SET_HEURISTIC,        /* per metre to the goal */
    PLANNER_SET_CHILDREN,         /* at most 16 */
    PLANNER_SET_NODES,            /* expanded nodes, at most 40 */
    PLANNER_SET_NODE_DISTANCE,    /* m */
    PLANNER_SET_SMOOTHING_RADIUS, /* cells, 1..7 (odd kernel of 2 r + 1) */
    PLANNER_SET_PERIOD,           /* s between plans */
    PLANNER_SET_PATH_SPEED,       /* advance along the path, m/s */
    PLANNER_SET_LINE_DISTANCE,    /* pull to the line between way-points beyond this, m */
    PLANNER_SET_LOOK_AHEAD,       /* set-point ahead of the vehicle at the centre of the field of view, m */
    PLANNER_SET_FOV_SLOWDOWN,     /* 0 none .. 1 full slow-down towards the edge of the field of view */
    PLANNER_SET_FOV_CENTRE,       /* field of view the planner has learnt: centre, deg, positive to the right */
    PLANNER_SET_FOV_LEARNT,       /* and width, deg */
    PLANNER_SET_SPEED_TAU,        /* low-pass of the speed, s */
    PLANNER_SET_SMOOTH_XY,        /* set-point spring, 0 off */
    PLANNER_SET_SMOOTH_Z,
    PLANNER_SETTING_COUNT
};

size_t planner_state_size(void);
void planner_init(void *state, const double *settings);
void planner_step(void *state, const double *in, const double *boxes, int n_boxes, double *out);

/* Windows for tests: what the parts compute, given plain arrays (float triples x, y, z). */
int planner_probe_cast(void *state, const double *eye, double yaw, const double *boxes, int n_boxes, float *points, int most);
void planner_probe_histogram(void *state, const float *points, int n, const double *eye, float *mean_m);
void planner_probe_costs(void *state, const float *points, int n, const double *eye, const double *velocity,
                         const double *goal, const double *line_point, float *costs);
int planner_path(void *state, float *points, int most);

#endif
