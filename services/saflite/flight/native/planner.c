/* The planner's life: settings and tables, then look, remember, search, set-point. */
#include "planner.h"

#include "exact_math.h"
#include "planner_state.h"

#include <string.h>

size_t planner_state_size(void) { return sizeof(Planner); }

static void read_settings(Settings *set, const double *from)
{
    set->range = (float)from[PLANNER_SET_RANGE];
    set->near = (float)from[PLANNER_SET_NEAR];
    set->half_h = (float)(from[PLANNER_SET_FOV_H] / 2.0);
    set->half_v = (float)(from[PLANNER_SET_FOV_V] / 2.0);
    set->columns = (int)exact_clamp(from[PLANNER_SET_COLUMNS], 2, RAY_COLUMNS_MAX);
    set->rows = (int)exact_clamp(from[PLANNER_SET_ROWS], 2, RAY_ROWS_MAX);
    set->memory_age = (float)from[PLANNER_SET_MEMORY_AGE];
    set->pitch_cost = (float)from[PLANNER_SET_PITCH_COST];
    set->yaw_cost = (float)from[PLANNER_SET_YAW_COST];
    set->velocity_cost = (float)from[PLANNER_SET_VELOCITY_COST];
    set->knee = (float)from[PLANNER_SET_OBSTACLE_KNEE];
    set->heuristic = (float)from[PLANNER_SET_HEURISTIC];
    set->children = (int)exact_clamp(from[PLANNER_SET_CHILDREN], 1, CHILDREN_MAX);
    set->expansions = (int)exact_clamp(from[PLANNER_SET_NODES], 1, EXPANSIONS_MAX);
    set->node_distance = (float)from[PLANNER_SET_NODE_DISTANCE];
    set->radius = (int)exact_clamp(from[PLANNER_SET_SMOOTHING_RADIUS], 1, RADIUS_MAX);
    set->period = from[PLANNER_SET_PERIOD];
    set->path_speed = (float)from[PLANNER_SET_PATH_SPEED];
    set->line_distance = (float)from[PLANNER_SET_LINE_DISTANCE];
    set->look_ahead = (float)from[PLANNER_SET_LOOK_AHEAD];
    set->fov_slowdown = (float)from[PLANNER_SET_FOV_SLOWDOWN];
    set->learnt_centre = (float)from[PLANNER_SET_FOV_CENTRE];
    set->learnt_half = (float)(from[PLANNER_SET_FOV_LEARNT] / 2.0);
    set->speed_tau = (float)from[PLANNER_SET_SPEED_TAU];
    set->smooth_xy = (float)from[PLANNER_SET_SMOOTH_XY];
    set->smooth_z = (float)from[PLANNER_SET_SMOOTH_Z];
}

static void fill_directions(Planner *p)
{
    for (int e = 0; e < ELEVATIONS; e++) {
        double sine, cosine, s, c;
        exact_sincos((e * CELL_DEG + CELL_DEG / 2 - 90) * EXACT_RAD, &sine, &cosine);
        p->row_sin[e] = (float)sine;
        p->row_cos[e] = (float)cosine;
        p->row_step[e] = (int)floor(1.0 / cosine + 0.5);
        for (int z = 0; z < AZIMUTHS; z++) {
            exact_sincos((z * CELL_DEG + CELL_DEG / 2 - 180) * EXACT_RAD, &s, &c);
            p->dir_x[e * AZIMUTHS + z] = (float)(cosine * c);
            p->dir_y[e * AZIMUTHS + z] = (float)(cosine * s);
            p->dir_z[e * AZIMUTHS + z] = (float)sine;
        }
    }
}

static void fill_rays(Planner *p)
{
    const double h = 2.0 * (double)p->set.half_h / p->set.columns, v = 2.0 * (double)p->set.half_v / p->set.rows;
    double sine, cosine;
    for (int i = 0; i < p->set.columns; i++)
        exact_sincos(((i + 0.5) * h - (double)p->set.half_h) * EXACT_RAD, &p->ray_sin[i], &p->ray_cos[i]);
    for (int j = 0; j < p->set.rows; j++) {
        exact_sincos(((j + 0.5) * v - (double)p->set.half_v) * EXACT_RAD, &sine, &cosine);
        p->ray_tan[j] = (float)(sine / cosine);
        p->ray_stretch[j] = (float)(1.0 / cosine);
    }
}

void planner_init(void *state, const double *settings)
{
    Planner *p = state;
    memset(p, 0, sizeof *p);
    read_settings(&p->set, settings);
    fill_directions(p);
    fill_rays(p);
    p->planned_s = p->looked_s = -1e9;
}

/* The point that pulls the vehicle back to the line between way-points; the goal itself while it is near the line. */
static void line_point(const Planner *p, const double *in, float point[3])
{
    const double *from = in + PLANNER_IN_FROM_X, *goal = in + PLANNER_IN_GOAL_X, *at = in + PLANNER_IN_X;
    const double lx = goal[0] - from[0], ly = goal[1] - from[1], length = sqrt(lx * lx + ly * ly);
    for (int i = 0; i < 3; i++)
        point[i] = (float)goal[i];
    if (length < 0.001)
        return;
    const double along = ((at[0] - from[0]) * lx + (at[1] - from[1]) * ly) / length;
    const double x = from[0] + lx / length * along, y = from[1] + ly / length * along;
    const double off = sqrt((at[0] - x) * (at[0] - x) + (at[1] - y) * (at[1] - y));
    if (off < (double)p->set.line_distance)
        return;
    point[0] = (float)x;
    point[1] = (float)y;
}

static void plan(Planner *p, const double *in, const double *boxes, int n_boxes)
{
    View root;
    float shift[3];
    for (int i = 0; i < 3; i++) {
        root.eye[i] = (float)in[PLANNER_IN_X + i];
        root.velocity[i] = (float)in[PLANNER_IN_VX + i];
        root.goal[i] = (float)in[PLANNER_IN_GOAL_X + i];
        shift[i] = (float)(in[PLANNER_IN_TRUE_X + i] - in[PLANNER_IN_X + i]);
    }
    memory_update(p, root.eye, shift, in[PLANNER_IN_YAW], in[PLANNER_IN_TIME], boxes, n_boxes);
    if (p->cloud.n == 0)
        return;
    line_point(p, in, root.line_point);
    tree_search(p, &root, in[PLANNER_IN_TIME]);
}

void planner_step(void *state, const double *in, const double *boxes, int n_boxes, double *out)
{
    Planner *p = state;
    if (in[PLANNER_IN_TIME] - p->planned_s >= p->set.period - 1e-6) {
        p->planned_s = in[PLANNER_IN_TIME];
        plan(p, in, boxes, n_boxes);
    }
    setpoint_step(p, in, out);
}

int planner_path(void *state, float *points, int most)
{
    Planner *p = state;
    const int n = p->n_path < most ? p->n_path : most;
    memcpy(points, p->path, sizeof(float) * 3 * (size_t)n);
    return n;
}

/* ---- windows for tests ---- */

static void set_cloud(Planner *p, const float *points, int n)
{
    p->cloud.n = n < POINTS_MAX ? n : POINTS_MAX;
    for (int i = 0; i < p->cloud.n; i++) {
        p->cloud.x[i] = points[3 * i];
        p->cloud.y[i] = points[3 * i + 1];
        p->cloud.z[i] = points[3 * i + 2];
    }
}

int planner_probe_cast(void *state, const double *eye, double yaw, const double *boxes, int n_boxes, float *points, int most)
{
    Planner *p = state;
    const float from[3] = {(float)eye[0], (float)eye[1], (float)eye[2]}, shift[3] = {0.0f, 0.0f, 0.0f};
    p->cloud.n = 0;
    memset(p->fine, 0, sizeof p->fine);
    camera_look(p, from, shift, yaw, boxes, n_boxes);
    const int n = p->cloud.n < most ? p->cloud.n : most;
    for (int i = 0; i < n; i++) {
        points[3 * i] = p->cloud.x[i];
        points[3 * i + 1] = p->cloud.y[i];
        points[3 * i + 2] = p->cloud.z[i];
    }
    return n;
}

void planner_probe_histogram(void *state, const float *points, int n, const double *eye, float *mean_m)
{
    Planner *p = state;
    const float from[3] = {(float)eye[0], (float)eye[1], (float)eye[2]};
    set_cloud(p, points, n);
    histogram_build(p, from);
    for (int i = 0; i < CELLS; i++)
        mean_m[i] = p->count[i] > 0.0f ? p->sum[i] / p->count[i] : 0.0f;
}

void planner_probe_costs(void *state, const float *points, int n, const double *eye, const double *velocity,
                         const double *goal, const double *line, float *costs)
{
    Planner *p = state;
    View view;
    for (int i = 0; i < 3; i++) {
        view.eye[i] = (float)eye[i];
        view.velocity[i] = (float)velocity[i];
        view.goal[i] = (float)goal[i];
        view.line_point[i] = (float)line[i];
    }
    set_cloud(p, points, n);
    costs_fill(p, &view, costs);
}
