/* The kinematic vehicle: see kinematic.h. */
#include "kinematic.h"

#include "boxes.h"
#include "exact_math.h"
#include "follower.h"
#include "noise.h"
#include "planner.h"

#include <string.h>

enum { DELAY_SLOTS = 16 };

typedef struct {
    const double *set, *mission, *boxes;
    int n_mission, n_boxes, leg, has_setpoint;
    void *planner;
    uint64_t seed;
    double t, p[3], v[3], a[2], yaw, drift[3], stuck_s, height_error, touched_s;
    double setpoint[PLANNER_OUT_COUNT], delayed[DELAY_SLOTS][PLANNER_OUT_COUNT], delayed_s[DELAY_SLOTS];
    int head, queued;
    Follower follower;
    FollowerLimits limits;
} Flight;

int mission_reached(const double from[3], const double goal[3], const double at[3], double accept_m, double accept_z_m,
                    double stuck_s)
{
    const double lx = goal[0] - from[0], ly = goal[1] - from[1], dx = goal[0] - at[0], dy = goal[1] - at[1];
    const double along = (at[0] - from[0]) * lx + (at[1] - from[1]) * ly, leg = lx * lx + ly * ly;
    const double off = sqrt(dx * dx + dy * dy);
    const int passed = leg > 1e-6 && fabs(along) > leg;
    const int level = fabs(goal[2] - at[2]) < accept_z_m || (off < accept_m && stuck_s > 2.0);
    return (off < accept_m || passed) && level;
}

/* Goal of leg i (0 is the climb): the landing leg keeps the height of the one before. */
static void leg_goal(const Flight *f, int leg, double goal[3])
{
    memcpy(goal, f->mission + 3 * leg, sizeof(double) * 3);
    if (leg == f->n_mission - 1)
        goal[2] = f->mission[3 * leg - 1];
}

static void estimate(const Flight *f, double at[3])
{
    for (int i = 0; i < 3; i++)
        at[i] = f->p[i] + f->drift[i];
}

static void drift(Flight *f)
{
    const double tau = f->set[KINEMATIC_SET_DRIFT_TAU], sd = f->set[KINEMATIC_SET_DRIFT];
    const double keep = 1.0 - KINEMATIC_STEP_S / tau, kick = sd * sqrt(1.0 - keep * keep);
    for (int i = 0; i < 3; i++)
        f->drift[i] = keep * f->drift[i] + (i < 2 ? kick : 0.5 * kick) * noise_normal(&f->seed);
}

/* Sets the set-point in force to the newest that is old enough to have arrived. */
static void deliver(Flight *f)
{
    while (f->queued > 0) {
        const int tail = (f->head + DELAY_SLOTS - f->queued) % DELAY_SLOTS;
        if (f->delayed_s[tail] > f->t + 1e-6)
            return;
        memcpy(f->setpoint, f->delayed[tail], sizeof f->setpoint);
        f->has_setpoint = 1;
        f->queued--;
    }
}

static void consult(Flight *f)
{
    double in[PLANNER_IN_COUNT];
    in[PLANNER_IN_TIME] = f->t;
    for (int i = 0; i < 3; i++) {
        in[PLANNER_IN_X + i] = f->p[i] + f->drift[i];
        in[PLANNER_IN_VX + i] = f->v[i];
        in[PLANNER_IN_TRUE_X + i] = f->p[i];
    }
    in[PLANNER_IN_YAW] = f->yaw;
    leg_goal(f, f->leg, in + PLANNER_IN_GOAL_X);
    leg_goal(f, f->leg > 0 ? f->leg - 1 : 0, in + PLANNER_IN_FROM_X);
    const double chance = (double)(noise_bits(&f->seed) >> 11) / 9007199254740992.0;
    if (chance < f->set[KINEMATIC_SET_JITTER] || f->queued >= DELAY_SLOTS)
        return;
    planner_step(f->planner, in, f->boxes, f->n_boxes, f->delayed[f->head]);
    f->delayed_s[f->head] = f->t + f->set[KINEMATIC_SET_LATENCY];
    f->head = (f->head + 1) % DELAY_SLOTS;
    f->queued++;
}

/* Moves in the plane with limited jerk and acceleration towards the wanted velocity. */
static void move_plane(Flight *f, double vx, double vy)
{
    const double dt = KINEMATIC_STEP_S, tau = f->set[KINEMATIC_SET_VELOCITY_TAU], jerk = f->set[KINEMATIC_SET_JERK] * dt;
    const double most = f->set[KINEMATIC_SET_ACCELERATION], wanted[2] = {(vx - f->v[0]) / tau, (vy - f->v[1]) / tau};
    const double size = sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1]), share = size > most ? most / size : 1.0;
    for (int i = 0; i < 2; i++) {
        f->a[i] += exact_clamp(wanted[i] * share - f->a[i], -jerk, jerk);
        f->v[i] += f->a[i] * dt;
        f->p[i] += f->v[i] * dt;
    }
}

static void move_height(Flight *f, double vz)
{
    f->v[2] += exact_clamp(vz - f->v[2], -3.0 * KINEMATIC_STEP_S, 3.0 * KINEMATIC_STEP_S);
    f->p[2] += f->v[2] * KINEMATIC_STEP_S;
    if (f->p[2] < 0.0) {
        f->p[2] = 0.0;
        f->v[2] = f->v[2] < 0.0 ? 0.0 : f->v[2];
    }
}

static void turn(Flight *f, double wanted)
{
    const double most = f->set[KINEMATIC_SET_YAW_RATE] * EXACT_RAD;
    const double rate = exact_clamp(f->set[KINEMATIC_SET_YAW_GAIN] * exact_wrap(wanted - f->yaw), -most, most);
    f->yaw = exact_wrap(f->yaw + rate * KINEMATIC_STEP_S);
}

/* The trajectory leads, the vehicle follows it with its position gain. */
static void follow(Flight *f)
{
    double goal[3], from[3], at[3];
    leg_goal(f, f->leg, goal);
    leg_goal(f, f->leg - 1, from);
    estimate(f, at);
    follower_step(&f->follower, &f->limits, from, goal, at, f->setpoint + PLANNER_OUT_X, KINEMATIC_STEP_S);
    const double *p = f->follower.position, *v = f->follower.velocity;
    const double gain = f->set[KINEMATIC_SET_POSITION_GAIN], lift = f->set[KINEMATIC_SET_HEIGHT_GAIN];
    move_plane(f, v[0] + gain * (p[0] - at[0]), v[1] + gain * (p[1] - at[1]));
    move_height(f, v[2] + lift * (p[2] - at[2]));
    turn(f, f->setpoint[PLANNER_OUT_YAW]);
}

static void enter_leg(Flight *f)
{
    double goal[3], from[3], at[3];
    estimate(f, at);
    if (f->leg <= 1)
        follower_start(&f->follower, at, f->v);
    if (f->leg < 1 || f->leg >= f->n_mission)
        return;
    leg_goal(f, f->leg, goal);
    leg_goal(f, f->leg - 1, from);
    follower_leg(&f->follower, from, goal, at, f->limits.accept);
}

static void advance(Flight *f)
{
    double goal[3], from[3], at[3];
    leg_goal(f, f->leg, goal);
    leg_goal(f, f->leg - 1, from);
    estimate(f, at);
    const double error = fabs(goal[2] - at[2]);
    f->stuck_s = error < f->height_error - 0.01 ? 0.0 : f->stuck_s + KINEMATIC_STEP_S;
    f->height_error = error;
    if (mission_reached(from, goal, at, f->set[KINEMATIC_SET_ACCEPT], f->set[KINEMATIC_SET_ACCEPT_Z], f->stuck_s)) {
        f->leg++;
        f->stuck_s = 0.0;
        enter_leg(f);
    }
}

static double descent(const Flight *f)
{
    const double slow = f->set[KINEMATIC_SET_LAND_SPEED], fast = f->set[KINEMATIC_SET_DOWN_MAX];
    return slow + (fast - slow) * exact_clamp((f->p[2] - 5.0) / 5.0, 0.0, 1.0);
}

static void land(Flight *f)
{
    const int slow = f->v[0] * f->v[0] + f->v[1] * f->v[1] < 0.25;
    move_plane(f, 0.0, 0.0);
    move_height(f, slow ? -descent(f) : 0.0);
    if (f->p[2] < 0.02)
        f->touched_s += KINEMATIC_STEP_S;
}

/* One step; returns 1 once the flight is over. */
static int step(Flight *f, int count)
{
    f->t = count * KINEMATIC_STEP_S;
    drift(f);
    if (f->t < f->set[KINEMATIC_SET_START_DELAY])
        return 0;
    if (f->leg == f->n_mission) {
        land(f);
        return f->touched_s >= f->set[KINEMATIC_SET_GROUND_TIME];
    }
    if (count % 2 == 0)
        consult(f);
    deliver(f);
    if (f->leg == 0) {
        move_plane(f, 0.0, 0.0);
        move_height(f, f->set[KINEMATIC_SET_CLIMB]);
        f->leg = f->p[2] > f->mission[2] - f->set[KINEMATIC_SET_ACCEPT_Z];
        enter_leg(f);
        return 0;
    }
    if (f->has_setpoint)
        follow(f);
    advance(f);
    return 0;
}

static int measure(const Flight *f, double *clearance)
{
    for (int i = 0; i < f->n_boxes; i++) {
        const double distance = boxes_distance(f->boxes + i * BOX_FIELDS, 1, f->p[0], f->p[1], f->p[2]);
        clearance[i] = distance < clearance[i] ? distance : clearance[i];
    }
    return boxes_contact(f->boxes, f->n_boxes, f->set[KINEMATIC_SET_CORE], f->p[0], f->p[1], f->p[2]) >= 0;
}

static void note(const Flight *f, double *row)
{
    row[0] = f->t;
    memcpy(row + 1, f->p, sizeof f->p);
    row[4] = f->yaw;
}

static void begin(Flight *f, const double *planner_settings)
{
    memcpy(f->p, f->mission, sizeof(double) * 2);
    f->yaw = f->set[KINEMATIC_SET_START_YAW] * EXACT_RAD;
    f->height_error = 1e9;
    for (int i = 0; i < 3; i++)
        f->drift[i] = 0.0;
    f->limits = (FollowerLimits){f->set[KINEMATIC_SET_ACCELERATION], f->set[KINEMATIC_SET_JERK], f->set[KINEMATIC_SET_SPEED_MAX],
                                 f->set[KINEMATIC_SET_UP_MAX], f->set[KINEMATIC_SET_DOWN_MAX], f->set[KINEMATIC_SET_ACCEPT],
                                 2.0, f->set[KINEMATIC_SET_TURN_LOCK]};
    planner_init(f->planner, planner_settings);
}

void kinematic_fly(void *state, const double *planner_settings, const double *settings, const double *mission, int n_mission,
                   const double *boxes, int n_boxes, uint64_t seed, double *track, int rows_max, double *out)
{
    Flight f = {.set = settings, .mission = mission, .boxes = boxes, .n_mission = n_mission, .n_boxes = n_boxes,
                .planner = state, .seed = seed};
    const int last = (int)(settings[KINEMATIC_SET_TIME_LIMIT] / KINEMATIC_STEP_S), every = (int)(KINEMATIC_TRACK_S / KINEMATIC_STEP_S + 0.5);
    double *clearance = out + KINEMATIC_OUT_COUNT;
    int ending = KINEMATIC_TIMED_OUT, rows = 0;
    for (int i = 0; i < n_boxes; i++)
        clearance[i] = NO_OBSTACLE_M;
    begin(&f, planner_settings);
    for (int count = 0; count <= last && ending == KINEMATIC_TIMED_OUT; count++) {
        if (step(&f, count))
            ending = KINEMATIC_COMPLETED;
        if (measure(&f, clearance))
            ending = KINEMATIC_CRASHED;
        if (rows < rows_max && (count % every == 0 || ending != KINEMATIC_TIMED_OUT))
            note(&f, track + KINEMATIC_TRACK_FIELDS * rows++);
    }
    out[KINEMATIC_OUT_ENDING] = ending;
    out[KINEMATIC_OUT_DURATION] = f.t;
    out[KINEMATIC_OUT_DISTANCE] = NO_OBSTACLE_M;
    out[KINEMATIC_OUT_ROWS] = rows;
    for (int i = 0; i < n_boxes; i++)
        out[KINEMATIC_OUT_DISTANCE] = clearance[i] < out[KINEMATIC_OUT_DISTANCE] ? clearance[i] : out[KINEMATIC_OUT_DISTANCE];
}
