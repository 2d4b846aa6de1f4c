/* See follower.h. */
#include "follower.h"

#include "exact_math.h"

#include <string.h>

double follower_speed(double jerk, double acceleration, double distance)
{
    const double b = 4.0 * acceleration * acceleration / jerk;
    return 0.5 * (sqrt(b * b + 8.0 * acceleration * distance) - b);
}

void follower_start(Follower *f, const double at[3], const double velocity[3])
{
    memset(f, 0, sizeof *f);
    memcpy(f->position, at, sizeof f->position);
    memcpy(f->velocity, velocity, sizeof f->velocity);
}

/* Where the vehicle stands to the line from -> goal; `closest` receives its foot on the line. */
static int line_state(const double from[3], const double goal[3], const double at[3], double accept_m, double closest[2])
{
    double ux = goal[0] - from[0], uy = goal[1] - from[1];
    const double length = sqrt(ux * ux + uy * uy);
    ux = length > 1e-6 ? ux / length : 0.0;
    uy = length > 1e-6 ? uy / length : 0.0;
    const double px = at[0] - from[0], py = at[1] - from[1], along = px * ux + py * uy;
    closest[0] = from[0] + ux * along;
    closest[1] = from[1] + uy * along;
    if (ux * (goal[0] - at[0]) + uy * (goal[1] - at[1]) < 0.0)
        return FOLLOWER_TARGET_BEHIND;
    if (along < 0.0 && px * px + py * py > accept_m * accept_m)
        return FOLLOWER_BEFORE_LINE;
    const double ox = at[0] - closest[0], oy = at[1] - closest[1];
    return ox * ox + oy * oy > accept_m * accept_m ? FOLLOWER_OFF_TRACK : FOLLOWER_ON_LINE;
}

static void aim(Follower *f, int state, const double from[3], const double goal[3], const double closest[2])
{
    const double *target = state == FOLLOWER_OFF_TRACK ? closest : state == FOLLOWER_BEFORE_LINE ? from : goal;
    f->target[0] = target[0];
    f->target[1] = target[1];
    f->line_state = state;
}

void follower_leg(Follower *f, const double from[3], const double goal[3], const double at[3], double accept_m)
{
    double closest[2];
    aim(f, line_state(from, goal, at, accept_m, closest), from, goal, closest);
}

static int is_turning(const Follower *f, double accept_m)
{
    const double tx = f->target[0] - f->position[0], ty = f->target[1] - f->position[1];
    const double speed = sqrt(f->velocity[0] * f->velocity[0] + f->velocity[1] * f->velocity[1]);
    const double far = sqrt(tx * tx + ty * ty);
    return speed > 0.2 && far > accept_m && f->velocity[0] * tx + f->velocity[1] * ty < 0.98 * speed * far;
}

/* One axis of the trajectory: acceleration and jerk limited approach to the wanted velocity. */
static void smooth_axis(Follower *f, int axis, double wanted, double most, double jerk, double dt)
{
    const double gap = wanted - f->velocity[axis], size = fabs(gap);
    const double curve = 0.9 * sqrt(2.0 * jerk * size), soft = 4.0 * size;
    double pull = curve < soft ? curve : soft;
    pull = pull < most ? pull : most;
    f->acceleration[axis] += exact_clamp((gap < 0.0 ? -pull : pull) - f->acceleration[axis], -jerk * dt, jerk * dt);
    f->velocity[axis] += f->acceleration[axis] * dt;
    f->position[axis] += f->velocity[axis] * dt;
}

/* Trajectory time runs slower while the vehicle trails behind its trajectory. */
static double stretched(const Follower *f, const FollowerLimits *limits, const double at[3], double dt)
{
    const double dx = f->position[0] - at[0], dy = f->position[1] - at[1];
    if (dx * f->velocity[0] + dy * f->velocity[1] < 0.0)
        return dt;
    return dt * (1.0 - exact_clamp(sqrt(dx * dx + dy * dy) / limits->error_max, 0.0, 1.0));
}

static double plane_speed(Follower *f, const FollowerLimits *limits, double distance)
{
    double speed = follower_speed(limits->jerk, limits->acceleration, distance);
    speed = speed < limits->cruise ? speed : limits->cruise;
    f->turning = limits->lock > 0.0 && is_turning(f, limits->accept);
    if (!f->turning)
        f->speed_before_turn = speed;
    return speed < f->speed_before_turn ? speed : f->speed_before_turn;
}

void follower_step(Follower *f, const FollowerLimits *limits, const double from[3], const double goal[3], const double at[3],
                   const double setpoint[3], double dt)
{
    double closest[2];
    const int state = line_state(from, goal, at, limits->accept, closest);
    if (state != f->line_state)
        aim(f, state, from, goal, closest);
    const double dx = setpoint[0] - f->position[0], dy = setpoint[1] - f->position[1], dz = setpoint[2] - f->position[2];
    const double distance = sqrt(dx * dx + dy * dy), speed = plane_speed(f, limits, distance);
    const double share = distance > 1e-9 ? speed / distance : 0.0, step = stretched(f, limits, at, dt);
    const double rise = follower_speed(limits->jerk, limits->acceleration, fabs(dz));
    const double most = dz > 0.0 ? limits->up : limits->down;
    smooth_axis(f, 0, dx * share, limits->acceleration, limits->jerk, step);
    smooth_axis(f, 1, dy * share, limits->acceleration, limits->jerk, step);
    smooth_axis(f, 2, (dz < 0.0 ? -1.0 : 1.0) * (rise < most ? rise : most), limits->acceleration, limits->jerk, step);
}
