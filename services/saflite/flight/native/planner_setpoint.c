/* From the path to the position and yaw set-point (seed-systems 5.6). */
#include "exact_math.h"
#include "planner_state.h"

#include <string.h>

enum { FOLLOWING, STRAIGHT, AT_GOAL };

/* It turns to a direction that has so much of the plane in it; steeper ones it flies where the camera looks, which may be
 * never: after so long at rest it goes down or up as it stands, the way ahead being no more in view for a turn. */
static const double TURN_FLAT = 0.1, AT_REST_M = 0.05, PATIENCE_S = 15.0;

/* Turns (dx, dy, dz) into a unit vector; returns its length, leaves a null vector alone. */
static double normalise(double v[3])
{
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int i = 0; i < 3 && length > 1e-9; i++)
        v[i] /= length;
    return length;
}

static double heading(double x, double y) { return (double)exact_atan2_deg((float)y, (float)x) * EXACT_RAD; }

/* 1 at the centre of the field of view the planner has learnt, falling to 0 at its edge and beyond. */
static double view_factor(const Planner *p, const double direction[3], double yaw)
{
    if (direction[0] == 0.0 && direction[1] == 0.0)
        return 1.0;
    const double off = exact_wrap(heading(direction[0], direction[1]) - yaw) / EXACT_RAD - (double)p->set.learnt_centre;
    const double inside = fabs(off) < (double)p->set.learnt_half ? 1.0 - fabs(off) / (double)p->set.learnt_half : 0.0;
    return 1.0 - (double)p->set.fov_slowdown * (1.0 - inside);
}

static void turn(Planner *p, double wanted, double dt)
{
    const double spring = (double)p->set.smooth_xy;
    if (spring <= 0.01) {
        p->yaw = exact_wrap(wanted);
        return;
    }
    p->yaw_rate += (spring * exact_wrap(wanted - p->yaw) - 2.0 * sqrt(spring) * p->yaw_rate) * dt;
    p->yaw = exact_wrap(p->yaw + p->yaw_rate * dt);
}

/* The set-point as a mass on a spring behind the wanted one, fed with the vehicle's own velocity. */
static void smooth(Planner *p, const double *in, const double wanted[3], int at_goal, double dt)
{
    for (int i = 0; i < 3; i++) {
        const double spring = (double)(i < 2 ? p->set.smooth_xy : p->set.smooth_z);
        if (spring <= 0.01) {
            p->smooth_position[i] = wanted[i];
            continue;
        }
        const double lead = at_goal ? 0.0 : in[PLANNER_IN_VX + i];
        p->smooth_velocity[i] += (spring * (wanted[i] - p->smooth_position[i]) +
                                  2.0 * sqrt(spring) * (lead - p->smooth_velocity[i])) * dt;
        p->smooth_position[i] += p->smooth_velocity[i] * dt;
    }
}

static void start(Planner *p, const double *in)
{
    memcpy(p->smooth_position, in + PLANNER_IN_X, sizeof p->smooth_position);
    memset(p->smooth_velocity, 0, sizeof p->smooth_velocity);
    p->yaw = in[PLANNER_IN_YAW];
    p->yaw_rate = 0.0;
    p->started = 1;
    p->stepped_s = in[PLANNER_IN_TIME] - 0.1;
}

/* Unit vector towards the path, or towards the goal where no path is valid. */
static int choose_direction(Planner *p, const double *in, const double to_goal[3], double direction[3])
{
    float point[3];
    const int valid = path_point(p, in[PLANNER_IN_TIME], point);
    for (int i = 0; i < 3; i++)
        direction[i] = valid ? (double)point[i] - in[PLANNER_IN_X + i] : to_goal[i];
    normalise(direction);
    return valid ? FOLLOWING : STRAIGHT;
}

/* Speed factor: how far ahead the set-point is laid. */
static void choose_speed(Planner *p, const double direction[3], double yaw, double goal_m, double dt)
{
    const double alpha = dt / ((double)p->set.speed_tau + dt);
    const double factor = p->hung_s > PATIENCE_S ? 1.0 : view_factor(p, direction, yaw);
    double wanted = goal_m < 1.0 ? goal_m : (double)p->set.look_ahead * factor;
    wanted = alpha * wanted + (1.0 - alpha) * p->speed_m;
    p->speed_m = wanted < goal_m ? wanted : goal_m;
}

void setpoint_step(Planner *p, const double *in, double *out)
{
    if (!p->started)
        start(p, in);
    const double dt = exact_clamp(in[PLANNER_IN_TIME] - p->stepped_s, 1e-4, 1.0), yaw = in[PLANNER_IN_YAW];
    double to_goal[3], direction[3], wanted[3];
    for (int i = 0; i < 3; i++)
        to_goal[i] = in[PLANNER_IN_GOAL_X + i] - in[PLANNER_IN_X + i];
    p->stepped_s = in[PLANNER_IN_TIME];
    int state = choose_direction(p, in, to_goal, direction);
    const double flat = sqrt(direction[0] * direction[0] + direction[1] * direction[1]);
    turn(p, flat > TURN_FLAT ? heading(direction[0], direction[1]) : yaw, dt);
    const double goal_m = normalise(to_goal);
    choose_speed(p, direction, yaw, goal_m, dt);
    if (flat > TURN_FLAT || goal_m < 1.0)
        p->hung_s = 0.0;
    else if (p->speed_m < AT_REST_M)
        p->hung_s += dt;
    if (goal_m < 1.0) {
        state = AT_GOAL;
        memcpy(direction, to_goal, sizeof direction);
        p->yaw_at_goal = p->has_yaw_at_goal ? p->yaw_at_goal : yaw;
        p->yaw = p->yaw_at_goal;
    }
    p->has_yaw_at_goal = goal_m < 1.0;
    for (int i = 0; i < 3; i++)
        wanted[i] = in[PLANNER_IN_X + i] + direction[i] * p->speed_m;
    smooth(p, in, wanted, goal_m - p->speed_m < 0.1, dt);
    memcpy(out + PLANNER_OUT_X, p->smooth_position, sizeof p->smooth_position);
    out[PLANNER_OUT_YAW] = p->yaw;
    out[PLANNER_OUT_SPEED] = p->speed_m;
    out[PLANNER_OUT_STATE] = state;
    out[PLANNER_OUT_POINTS] = p->cloud.n;
    out[PLANNER_OUT_PATH] = p->n_path;
}
