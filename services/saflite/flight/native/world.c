/* The world around JSBSim: standing and crashing, distance to boxes, the first contact it cannot model. */
#include "world.h"

#include <math.h>
#include <string.h>

#include "boxes.h"

#define AT(name) (w->at[WORLD_##name])
#define DEGREES (180.0 / PI)

static const double CORE = 0.8;           /* the box one can hit, as a share of the box one can see */
static const double HALF_WIDTH_M = 0.125; /* of the vehicle */

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    WORLD_SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

const char *world_slot_name(int slot) { return slot >= 0 && slot < WORLD_SLOT_COUNT ? NAMES[slot] : NULL; }
size_t world_size(void) { return sizeof(World); }

void world_start(World *w, const double *boxes, int box_count, int steps_per_state)
{
    memset(w, 0, sizeof *w);
    w->boxes = boxes, w->box_count = box_count, w->steps_per_state = steps_per_state;
}

void world_connect(World *w, PyObject *run, PyObject *const *nodes, double origin_m)
{
    w->run = run, w->nodes = nodes, w->origin_m = origin_m;
}

static void meet_boxes(World *w)
{
    AT(obstacle_distance_m) = boxes_distance(w->boxes, w->box_count, AT(x_m), AT(y_m), AT(altitude_m));
    for (int i = 0; i < w->box_count; i++) {
        const double *box = w->boxes + BOX_FIELDS * i;
        const int within = AT(altitude_m) <= box[BOX_TOP] + HALF_WIDTH_M && AT(altitude_m) >= box[BOX_BASE];
        if (within && box_plane_distance(box, CORE, AT(x_m), AT(y_m)) <= HALF_WIDTH_M)
            AT(contact) = 1.0;
    }
}

static void tell(World *w)
{
    AT(time_s) = AT(step) * STEP_S;
    AT(roll_deg) = AT(roll_rad) * DEGREES, AT(pitch_deg) = AT(pitch_rad) * DEGREES;
    const double yaw = AT(yaw_rad) * DEGREES;
    AT(yaw_deg) = yaw < 0.0 ? yaw + 360.0 : yaw;
    AT(roll_rate_dps) = AT(roll_rate_rps) * DEGREES, AT(pitch_rate_dps) = AT(pitch_rate_rps) * DEGREES;
    AT(yaw_rate_dps) = AT(yaw_rate_rps) * DEGREES;
    meet_boxes(w);
}

/* The world stops at the first contact it cannot model: a box, a fall, a tilted touch-down, numbers gone wild. */
static void judge_contact(World *w)
{
    if (AT(world_state) != WORLD_FLYING)
        return;
    const double tilt = cos(AT(roll_rad)) * cos(AT(pitch_rad)), sink = -AT(climb_mps);
    const double force = fabs(AT(force_x_mps2)) + fabs(AT(force_y_mps2)) + fabs(AT(force_z_mps2));
    const int low = AT(altitude_m) < 0.25;
    const int wild = !(fabs(AT(altitude_m)) < 1e6) || !(force < 1e4) || !(fabs(sink) < 1e3);
    /* a fall so fast that it was thrown back before the next state shows in how its speed changed near the ground */
    const double way_m = 2.0 * w->steps_per_state * STEP_S * w->last_sink_mps;
    const int thrown = w->last_sink_mps > 3.5 && w->last_m < 0.25 + way_m && sink < w->last_sink_mps - 3.0;
    w->last_m = AT(altitude_m), w->last_sink_mps = sink;
    const int fell = thrown || (low && (tilt < 0.64 || sink > 3.5 || (force > 120.0 && sink > 2.5)));
    if (wild || AT(contact) != 0.0)
        AT(world_state) = WORLD_CRASHED;
    else if (low && AT(chute_released) != 0.0)
        AT(world_state) = WORLD_FROZEN;
    else if (fell)
        AT(world_state) = WORLD_CRASHED;
}

static void feel_rest(World *w)
{
    AT(roll_rate_rps) = AT(pitch_rate_rps) = AT(yaw_rate_rps) = AT(force_x_mps2) = AT(force_y_mps2) = 0.0;
    AT(force_z_mps2) = -GRAVITY;
}

static void rest(World *w)
{
    AT(vx_mps) = AT(vy_mps) = 0.0;
    AT(climb_mps) = -0.0; /* the negative of a sink rate of 0, as in flight */
}

int world_read(World *w)
{
    if (jsbsim_read_rates(w) || jsbsim_read_state(w))
        return -1;
    tell(w);
    return 0;
}

int world_actuate(World *w, const double throttles[MOTORS])
{
    for (int i = 0; i < MOTORS; i++)
        w->at[WORLD_motor_1 + i] = w->at[WORLD_command_1 + i] = throttles[i];
    if (AT(motor_failed) >= 1.0 && AT(motor_failed) <= MOTORS)
        w->at[WORLD_motor_1 + (int)AT(motor_failed) - 1] *= AT(motor_failed_share);
    return AT(world_state) == WORLD_FLYING ? jsbsim_write_motors(w) : 0;
}

int world_advance(World *w)
{
    const int moving = AT(world_state) == WORLD_FLYING;
    AT(step) += 1.0;
    if (moving && (jsbsim_run(w) || jsbsim_read_rates(w)))
        return -1;
    if (!moving)
        feel_rest(w);
    if ((int64_t)AT(step) % w->steps_per_state == 0) {
        if (moving && jsbsim_read_state(w))
            return -1;
        if (!moving)
            rest(w);
        tell(w);
        judge_contact(w);
    }
    return 0;
}

int world_step(World *w, const double throttles[MOTORS])
{
    for (int i = 0; i < MOTORS; i++)
        if (AT(world_state) == WORLD_STANDING && throttles[i] > 0.0)
            AT(world_state) = WORLD_FLYING;
    return world_actuate(w, throttles) ? -1 : world_advance(w);
}

void world_follow(World *w)
{
    tell(w);
    if (AT(contact) != 0.0)
        AT(world_state) = WORLD_CRASHED;
}
