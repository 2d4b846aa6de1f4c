/* Histogram of distances and the cost of every direction (seed-systems 5.4).
 *
 * The original fills, smooths and searches a whole matrix for every node. The same numbers come cheaper: yaw and line
 * cost depend on the column only, pitch cost on the row only, the cone kernel is two running boxes, and a row is
 * skipped when its least possible cost already exceeds the worst candidate held. */
#include "exact_math.h"
#include "planner_state.h"

#include <string.h>

static float square(float value) { return value * value; }

static float wrap_deg(float angle) { return angle - 360.0f * floorf(angle / 360.0f + 0.5f); }

static float row_deg(int row) { return (float)(row * CELL_DEG + CELL_DEG / 2 - 90); }

static float column_deg(int column) { return (float)(column * CELL_DEG + CELL_DEG / 2 - 180); }

static float azimuth_of(const float from[3], const float to[3]) { return exact_atan2_deg(to[1] - from[1], to[0] - from[0]); }

static float elevation_of(const float from[3], const float to[3])
{
    return exact_atan2_deg(to[2] - from[2], sqrtf(square(to[0] - from[0]) + square(to[1] - from[1])));
}

/* Sum and count of distances per cell as seen from `eye`. */
EXACT_WIDE void histogram_build(Planner *p, const float eye[3])
{
    const Cloud *cloud = &p->cloud;
    const int n = cloud->n;
    const float ex = eye[0], ey = eye[1], ez = eye[2];
    memset(p->sum, 0, sizeof p->sum);
    memset(p->count, 0, sizeof p->count);
    for (int i = 0; i < n; i++) {
        const float dx = cloud->x[i] - ex, dy = cloud->y[i] - ey, dz = cloud->z[i] - ez;
        const float flat = dx * dx + dy * dy;
        const float azimuth = exact_atan2_deg(dy, dx), elevation = exact_atan2_deg(dz, sqrtf(flat));
        int column = (int)((azimuth + 180.0f) * (1.0f / CELL_DEG)), row = (int)((elevation + 90.0f) * (1.0f / CELL_DEG));
        column = column >= AZIMUTHS ? AZIMUTHS - 1 : column;
        row = row >= ELEVATIONS ? ELEVATIONS - 1 : row;
        p->cell_of[i] = row * AZIMUTHS + column;
        p->range_of[i] = sqrtf(flat + dz * dz);
    }
    int least = CELLS, most = -1;
    for (int i = 0; i < n; i++) {
        const int cell = p->cell_of[i];
        p->sum[cell] += p->range_of[i];
        p->count[cell] += 1.0f;
        least = cell < least ? cell : least;
        most = cell > most ? cell : most;
    }
    p->occupied = n;
    p->row_least = n ? least / AZIMUTHS : 0;
    p->row_most = n ? most / AZIMUTHS : -1;
}

/* Fills the columns a row near a pole leaves out, linearly between those computed. */
static void interpolate(float *row, int step)
{
    int last = 0;
    for (int z = step; z < AZIMUTHS; z += step) {
        const float slope = (row[z] - row[last]) / (float)step;
        for (int i = 1; i < step; i++)
            row[last + i] = row[last] + slope * (float)i;
        last = z;
    }
    const int rest = AZIMUTHS - last;
    const float slope = (row[0] - row[last]) / (float)rest;
    for (int i = 1; i < rest; i++)
        row[last + i] = row[last] + slope * (float)i;
}

/* Cost of the obstacle in every occupied cell, before smoothing, written to the middle of the padded matrix. */
EXACT_WIDE static void obstacle_rows(Planner *p)
{
    const float knee = p->set.knee;
    memset(p->smooth_a, 0, sizeof p->smooth_a);
    for (int e = p->row_least; e <= p->row_most; e++) {
        const int step = p->row_step[e];
        float *row = p->smooth_a[e + RADIUS_MAX];
        for (int z = 0; z < AZIMUTHS; z++) {
            const float n = p->count[e * AZIMUTHS + z], d = knee - p->sum[e * AZIMUTHS + z] / n;
            row[z] = n > 0.0f ? 5000.0f * (1.0f + d / sqrtf(1.0f + d * d)) : 0.0f;
        }
        if (step > 1)
            interpolate(row, step);
    }
}

/* Over a pole the matrix goes on half a turn further, upside down. */
static void pad_poles(Planner *p)
{
    enum { HALF = AZIMUTHS / 2 };
    for (int k = 0; k < RADIUS_MAX; k++) {
        const float *low = p->smooth_a[RADIUS_MAX + k], *high = p->smooth_a[RADIUS_MAX + ELEVATIONS - 1 - k];
        float *below = p->smooth_a[RADIUS_MAX - 1 - k], *above = p->smooth_a[RADIUS_MAX + ELEVATIONS + k];
        memcpy(below, low + HALF, sizeof(float) * HALF);
        memcpy(below + HALF, low, sizeof(float) * HALF);
        memcpy(above, high + HALF, sizeof(float) * HALF);
        memcpy(above + HALF, high, sizeof(float) * HALF);
    }
}

/* out[i] = in[i] + ... + in[i + width - 1] for i < n, by doubling where width is 8. */
EXACT_WIDE static void running_sum(const float *in, float *out, int n, int width)
{
    if (width == 8) {
        for (int i = 0; i < n; i++)
            out[i] = ((in[i] + in[i + 1]) + (in[i + 2] + in[i + 3])) + ((in[i + 4] + in[i + 5]) + (in[i + 6] + in[i + 7]));
        return;
    }
    for (int i = 0; i < n; i++) {
        float sum = in[i];
        for (int k = 1; k < width; k++)
            sum += in[i + k];
        out[i] = sum;
    }
}

/* out = the sum of `width` rows from `from` on, added in their order. */
static void add_rows(const float (*from)[AZIMUTHS], float *out, int width)
{
    for (int z = 0; z < AZIMUTHS; z++) {
        float sum = from[0][z] + from[1][z];
        for (int k = 2; k < width; k++)
            sum += from[k][z];
        out[z] = sum;
    }
}

/* Smooths along elevation: a cone of radius r is a box of r + 1 run twice; the result stands in smooth_a, row e. What
 * would be a sum of empty rows is left empty: `first` to `last` are the rows of the padded matrix that hold something. */
EXACT_WIDE static void smooth_columns(Planner *p)
{
    const int width = p->set.radius + 1, top = RADIUS_MAX - p->set.radius;
    int first = p->row_least < RADIUS_MAX ? 0 : RADIUS_MAX + p->row_least;
    int last = p->row_most >= ELEVATIONS - RADIUS_MAX ? PADDED_ROWS - 1 : RADIUS_MAX + p->row_most;
    for (int pass = 0; pass < 2; pass++) {
        float (*from)[AZIMUTHS] = pass ? p->smooth_b : p->smooth_a, (*to)[AZIMUTHS] = pass ? p->smooth_a : p->smooth_b;
        const int rows = ELEVATIONS + (pass ? 0 : p->set.radius), offset = pass ? 0 : top;
        for (int e = 0; e < rows; e++)
            if (e + offset > last || e + offset + width <= first)
                memset(to[e], 0, sizeof to[e]);
            else if (width == 8)
                add_rows((const float (*)[AZIMUTHS])(from + e + offset), to[e], 8);
            else
                add_rows((const float (*)[AZIMUTHS])(from + e + offset), to[e], width);
        first -= offset + width - 1;
        last -= offset;
    }
    p->smooth_first = first;
    p->smooth_last = last;
}

/* The row smoothed along azimuth as well, scaled as the original's kernel (peak 1 per axis). */
EXACT_WIDE static void smooth_row(Planner *p, int e, float *out)
{
    const int r = p->set.radius;
    const float *row = p->smooth_a[e], scale = 1.0f / (float)((r + 1) * (r + 1));
    memcpy(p->row_a + r, row, sizeof(float) * AZIMUTHS);
    memcpy(p->row_a, row + AZIMUTHS - r, sizeof(float) * (size_t)r);
    memcpy(p->row_a + r + AZIMUTHS, row, sizeof(float) * (size_t)r);
    running_sum(p->row_a, p->row_b, AZIMUTHS + r, r + 1);
    running_sum(p->row_b, out, AZIMUTHS, r + 1);
    for (int z = 0; z < AZIMUTHS; z++)
        out[z] *= scale;
}

/* True if a cell within 5 columns and 2 rows of the goal's direction holds something in range. */
static int goal_faced(const Planner *p, float azimuth, float elevation)
{
    for (int j = -2; j <= 2; j++)
        for (int i = -5; i <= 5; i++) {
            float a = azimuth + (float)(i * CELL_DEG), e = elevation + (float)(j * CELL_DEG);
            if (fabsf(e) > 90.0f) {
                e = (e > 0.0f ? 180.0f : -180.0f) - e;
                a += 180.0f;
            }
            const int cell = cell_index(wrap_deg(a), e, CELL_DEG, AZIMUTHS, ELEVATIONS);
            const float mean = p->count[cell] > 0.0f ? p->sum[cell] / p->count[cell] : 0.0f;
            if (mean > 0.2f && mean < p->set.range)
                return 1;
        }
    return 0;
}

typedef struct {
    float column[AZIMUTHS], pitch[ELEVATIONS], bound[ELEVATIONS], speed, weight, vx, vy, vz;
} Parts;

/* Costs that depend on the column or the row alone, and the least cost a row can hold. */
EXACT_WIDE static void cost_parts(const Planner *p, const View *view, Parts *parts)
{
    const float goal_azimuth = azimuth_of(view->eye, view->goal), goal_elevation = elevation_of(view->eye, view->goal);
    const float line_azimuth = azimuth_of(view->eye, view->line_point);
    const float share = goal_faced(p, goal_azimuth, goal_elevation) ? 0.0f : 0.5f;
    const float far = sqrtf(square(view->goal[0] - view->eye[0]) + square(view->goal[1] - view->eye[1]) +
                            square(view->goal[2] - view->eye[2]));
    const float press = far < 5.0f ? 1.0f / (square(0.2f * far) + 1e-9f) : 1.0f;
    const float flat = sqrtf(square(view->velocity[0]) + square(view->velocity[1])), vz = view->velocity[2];
    parts->speed = sqrtf(flat * flat + vz * vz);
    parts->weight = p->set.velocity_cost;
    parts->vx = view->velocity[0];
    parts->vy = view->velocity[1];
    parts->vz = vz;
    for (int z = 0; z < AZIMUTHS; z++)
        parts->column[z] = p->set.yaw_cost * ((1.0f - share) * square(wrap_deg(column_deg(z) - goal_azimuth)) +
                                              share * square(wrap_deg(column_deg(z) - line_azimuth)));
    for (int e = 0; e < ELEVATIONS; e++) {
        parts->pitch[e] = p->set.pitch_cost * square(row_deg(e) - goal_elevation) * press;
        const float best = p->row_cos[e] * flat + p->row_sin[e] * vz;
        parts->bound[e] = parts->pitch[e] + 0.999f * parts->weight * (parts->speed - best) - 1.0f;
    }
}

EXACT_WIDE static void cost_row(Planner *p, const Parts *parts, int e, float *out)
{
    const float *dx = p->dir_x + e * AZIMUTHS, *dy = p->dir_y + e * AZIMUTHS, *dz = p->dir_z + e * AZIMUTHS;
    for (int z = 0; z < AZIMUTHS; z++)
        out[z] = parts->column[z] + parts->pitch[e] +
                 parts->weight * (parts->speed - (dx[z] * parts->vx + dy[z] * parts->vy + dz[z] * parts->vz));
    if (p->row_step[e] > 1)
        interpolate(out, p->row_step[e]);
    if (p->occupied && e >= p->smooth_first && e <= p->smooth_last) {
        float smoothed[AZIMUTHS];
        smooth_row(p, e, smoothed);
        for (int z = 0; z < AZIMUTHS; z++)
            out[z] += smoothed[z];
    }
}

static void prepare(Planner *p, const View *view, Parts *parts)
{
    histogram_build(p, view->eye);
    cost_parts(p, view, parts);
    if (p->occupied) {
        obstacle_rows(p);
        pad_poles(p);
        smooth_columns(p);
    }
}

static void keep(Candidate *best, int *held, int most, float cost, int row, int column)
{
    int at = *held < most ? (*held)++ : most - 1;
    for (; at > 0 && best[at - 1].cost > cost; at--)
        best[at] = best[at - 1];
    best[at].cost = cost;
    best[at].row = (short)row;
    best[at].column = (short)column;
}

/* The `most` cheapest cells, cheapest first; returns how many. */
int costs_candidates(Planner *p, const View *view, Candidate *best, int most)
{
    Parts parts;
    int held = 0, centre = 0;
    prepare(p, view, &parts);
    for (int e = 1; e < ELEVATIONS; e++)
        centre = parts.bound[e] < parts.bound[centre] ? e : centre;
    for (int k = 0; k < 2 * ELEVATIONS; k++) {
        const int e = centre + (k % 2 ? (k + 1) / 2 : -(k / 2));
        if (e < 0 || e >= ELEVATIONS || (held == most && parts.bound[e] >= best[most - 1].cost))
            continue;
        cost_row(p, &parts, e, p->row_cost);
        for (int z = 0; z < AZIMUTHS; z++)
            if (held < most || p->row_cost[z] < best[most - 1].cost)
                keep(best, &held, most, p->row_cost[z], e, z);
    }
    return held;
}

/* The whole matrix, CELLS floats; for tests. */
void costs_fill(Planner *p, const View *view, float *costs)
{
    Parts parts;
    prepare(p, view, &parts);
    for (int e = 0; e < ELEVATIONS; e++)
        cost_row(p, &parts, e, costs + e * AZIMUTHS);
}
