/* What the planner's files share: the state block and the parts' entry points. Angles here are degrees, lengths
 * metres, floats as in the original. */
#ifndef SAFLITE_PLANNER_STATE_H
#define SAFLITE_PLANNER_STATE_H

#include "planner.h"

enum {
    CELL_DEG = 6, AZIMUTHS = 360 / CELL_DEG, ELEVATIONS = 180 / CELL_DEG, CELLS = AZIMUTHS * ELEVATIONS,
    FINE_DEG = 2, FINE_AZIMUTHS = 360 / FINE_DEG, FINE_ELEVATIONS = 180 / FINE_DEG,
    RAY_COLUMNS_MAX = 64, RAY_ROWS_MAX = 48, POINTS_MAX = 4096, RADIUS_MAX = 7, CHILDREN_MAX = 16,
    EXPANSIONS_MAX = 40, NODES_MAX = 1 + EXPANSIONS_MAX * CHILDREN_MAX, PADDED_ROWS = ELEVATIONS + 2 * RADIUS_MAX,
    PADDED_COLUMNS = AZIMUTHS + 2 * RADIUS_MAX + 2
};

typedef struct { float x[POINTS_MAX], y[POINTS_MAX], z[POINTS_MAX], age_s[POINTS_MAX]; int n; } Cloud;

typedef struct {
    float position[3], velocity[3], total, heuristic;
    short parent, depth, closed;
} Node;

typedef struct { float cost; short row, column; } Candidate;

typedef struct {                       /* what a cost matrix is computed for */
    float eye[3], velocity[3], goal[3], line_point[3];
} View;

typedef struct {
    float range, near, half_h, half_v, memory_age, pitch_cost, yaw_cost, velocity_cost, knee, heuristic, node_distance;
    float path_speed, line_distance, look_ahead, fov_slowdown, learnt_centre, learnt_half, speed_tau, smooth_xy, smooth_z;
    double period;
    int columns, rows, children, expansions, radius;
} Settings;

typedef struct Planner {
    Settings set;
    /* tables */
    float dir_x[CELLS], dir_y[CELLS], dir_z[CELLS], row_sin[ELEVATIONS], row_cos[ELEVATIONS];
    int row_step[ELEVATIONS];
    double ray_cos[RAY_COLUMNS_MAX], ray_sin[RAY_COLUMNS_MAX];
    float ray_tan[RAY_ROWS_MAX], ray_stretch[RAY_ROWS_MAX];
    /* memory */
    Cloud cloud, older, seen;
    float azimuth_of[POINTS_MAX], elevation_of[POINTS_MAX];
    unsigned char fine[FINE_AZIMUTHS * FINE_ELEVATIONS];
    double looked_s;
    /* work space of one cost matrix */
    int cell_of[POINTS_MAX];
    float range_of[POINTS_MAX], sum[CELLS], count[CELLS];
    float smooth_a[PADDED_ROWS][AZIMUTHS], smooth_b[PADDED_ROWS][AZIMUTHS], row_cost[AZIMUTHS];
    float row_a[PADDED_COLUMNS], row_b[PADDED_COLUMNS];
    int occupied, row_least, row_most, smooth_first, smooth_last;  /* rows: least and most that hold anything */
    /* tree and path: path[0] is the vehicle, path[1] the first node */
    Node nodes[NODES_MAX];
    int n_nodes;
    float path[EXPANSIONS_MAX + 2][3];
    int n_path;
    double path_made_s, planned_s;
    /* set-point */
    double stepped_s, speed_m, smooth_position[3], smooth_velocity[3], yaw, yaw_rate, yaw_at_goal, hung_s;
    int started, has_yaw_at_goal;
} Planner;

void camera_look(Planner *p, const float eye[3], const float shift[3], double yaw, const double *boxes, int n_boxes);
void memory_update(Planner *p, const float eye[3], const float shift[3], double yaw, double now_s, const double *boxes,
                   int n_boxes);
/* Cell of a direction in a matrix of `azimuths` x `elevations` cells. */
static inline int cell_index(float azimuth_deg, float elevation_deg, int cell_deg, int azimuths, int elevations)
{
    int column = (int)((azimuth_deg + 180.0f) / (float)cell_deg), row = (int)((elevation_deg + 90.0f) / (float)cell_deg);
    column = column >= azimuths ? azimuths - 1 : column < 0 ? 0 : column;
    row = row >= elevations ? elevations - 1 : row < 0 ? 0 : row;
    return row * azimuths + column;
}

void histogram_build(Planner *p, const float eye[3]);
int costs_candidates(Planner *p, const View *view, Candidate *best, int most);
void costs_fill(Planner *p, const View *view, float *costs);

void tree_search(Planner *p, const View *root, double now_s);
int path_point(const Planner *p, double now_s, float point[3]);

void setpoint_step(Planner *p, const double *in, double *out);

#endif
