/* Truth for the trace: signals in the units policies read, distance to boxes, the first bad contact. */
#include <math.h>

#include "vehicle.h"

#define AT(name) (v->at[S_##name])
#define DEGREES (180.0 / PI)

static const double CORE = 0.8;          /* the box one can hit, as a share of the box one can see */
static const double HALF_WIDTH_M = 0.125; /* of the vehicle */
static const double CLEAR_M = 1000.0;

/* Distance in the plane to a rectangle with half sides scaled by `scale`; 0 inside. */
static double plane_distance(const double *box, double scale, double x, double y)
{
    const double dx = x - box[0], dy = y - box[1];
    const double along = fabs(box[4] * dx + box[5] * dy) - scale * box[2];
    const double across = fabs(-box[5] * dx + box[4] * dy) - scale * box[3];
    const double a = along > 0.0 ? along : 0.0, b = across > 0.0 ? across : 0.0;
    return sqrt(a * a + b * b);
}

/* Competition distance: in the plane to the full box, above the footprint the height over its top. */
static void boxes(Vehicle *v)
{
    double nearest = CLEAR_M;
    for (int i = 0; i < v->box_count; i++) {
        const double *box = v->boxes + 8 * i;
        double gap = plane_distance(box, 1.0, AT(x_m), AT(y_m));
        if (gap == 0.0 && AT(altitude_m) > box[7])
            gap = AT(altitude_m) - box[7];
        nearest = gap < nearest ? gap : nearest;
        const int within = AT(altitude_m) <= box[7] + HALF_WIDTH_M && AT(altitude_m) >= box[6];
        if (within && plane_distance(box, CORE, AT(x_m), AT(y_m)) <= HALF_WIDTH_M)
            AT(contact) = 1.0;
    }
    AT(obstacle_distance_m) = nearest;
}

void world_state(Vehicle *v)
{
    AT(time_s) = (double)v->step * STEP_S;
    AT(x_m) = AT(north_m), AT(y_m) = AT(east_m), AT(altitude_m) = AT(up_m);
    AT(vx_mps) = AT(v_north), AT(vy_mps) = AT(v_east), AT(climb_mps) = -AT(v_down);
    AT(roll_deg) = AT(phi) * DEGREES, AT(pitch_deg) = AT(theta) * DEGREES;
    const double yaw = AT(psi) * DEGREES;
    AT(yaw_deg) = yaw < 0.0 ? yaw + 360.0 : yaw;
    AT(roll_rate_dps) = AT(p_rps) * DEGREES, AT(pitch_rate_dps) = AT(q_rps) * DEGREES;
    AT(yaw_rate_dps) = AT(r_rps) * DEGREES;
    const double n = AT(north_m) - AT(home_north), e = AT(east_m) - AT(home_east);
    AT(home_distance_m) = sqrt(n * n + e * e);
    boxes(v);
}

/* The world stops at the first contact it cannot model: a box, a fall, a tilted touch-down, numbers gone wild. */
void world_contact(Vehicle *v)
{
    if (AT(world_state) != WORLD_FLYING)
        return;
    const double tilt = cos(AT(phi)) * cos(AT(theta)), force = fabs(AT(force_x)) + fabs(AT(force_y)) + fabs(AT(force_z));
    const int low = AT(up_m) < 0.25;
    const int wild = !(fabs(AT(up_m)) < 1e6) || !(force < 1e4) || !(fabs(AT(v_down)) < 1e3);
    const int fell = low && (tilt < 0.64 || AT(v_down) > 3.5 || (force > 120.0 && AT(v_down) > 2.5));
    if (wild || AT(contact) != 0.0)
        AT(world_state) = WORLD_CRASHED;
    else if (low && AT(chute_released) != 0.0)
        AT(world_state) = WORLD_FROZEN;
    else if (fell)
        AT(world_state) = WORLD_CRASHED;
}
