/* The depth camera and the memory of points (seed-systems 5.1 and 5.3). */
#include "boxes.h"
#include "exact_math.h"
#include "planner_state.h"

#include <string.h>

/* Horizontal distances at which a ray enters and leaves a box; 0 if it misses or starts inside (an inner face is not seen). */
static int crossing(const double *box, double x, double y, double ux, double uy, double *enter, double *leave)
{
    const double dx = x - box[BOX_X], dy = y - box[BOX_Y], c = box[BOX_COS], s = box[BOX_SIN];
    const double start[2] = {dx * c + dy * s, dy * c - dx * s}, step[2] = {ux * c + uy * s, uy * c - ux * s};
    const double half[2] = {box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH]};
    double first = -1e9, last = 1e9;
    for (int axis = 0; axis < 2; axis++) {
        if (fabs(step[axis]) < 1e-12) {
            if (fabs(start[axis]) > half[axis])
                return 0;
            continue;
        }
        const double a = (-half[axis] - start[axis]) / step[axis], b = (half[axis] - start[axis]) / step[axis];
        const double low = a < b ? a : b, high = a < b ? b : a;
        first = low > first ? low : first;
        last = high < last ? high : last;
    }
    *enter = first;
    *leave = last;
    return first < last && first > 0.0;
}

/* Horizontal distance at which a ray of slope `tan` from height z meets the box's side, roof or floor; 1e9 if never. */
static double meets(const double *box, double z, double tan, double enter, double leave)
{
    const double height = z + tan * enter;
    if (height >= box[BOX_BASE] && height <= box[BOX_TOP])
        return enter;
    const double plane = height > box[BOX_TOP] ? box[BOX_TOP] : box[BOX_BASE];
    const double at = tan != 0.0 ? (plane - z) / tan : -1.0;
    return at > enter && at < leave ? at : 1e9;
}

/* Directions of a cloud's points from `eye` (degrees) and their fine cells. */
EXACT_WIDE static void directions(Planner *p, const Cloud *from, const float eye[3])
{
    const int n = from->n;
    const float ex = eye[0], ey = eye[1], ez = eye[2];
    for (int i = 0; i < n; i++) {
        const float dx = from->x[i] - ex, dy = from->y[i] - ey, dz = from->z[i] - ez;
        const float azimuth = exact_atan2_deg(dy, dx), elevation = exact_atan2_deg(dz, sqrtf(dx * dx + dy * dy));
        p->azimuth_of[i] = azimuth;
        p->elevation_of[i] = elevation;
        p->cell_of[i] = cell_index(azimuth, elevation, FINE_DEG, FINE_AZIMUTHS, FINE_ELEVATIONS);
    }
}

/* Keeps point i of a cloud whose directions are known, unless its fine cell is taken. */
static void add_point(Planner *p, const Cloud *from, int i, float age_s)
{
    Cloud *cloud = &p->cloud;
    if (p->fine[p->cell_of[i]] || cloud->n >= POINTS_MAX)
        return;
    p->fine[p->cell_of[i]] = 1;
    cloud->x[cloud->n] = from->x[i];
    cloud->y[cloud->n] = from->y[i];
    cloud->z[cloud->n] = from->z[i];
    cloud->age_s[cloud->n++] = age_s;
}

/* Adds what the camera sees from `eye` + `shift` (its true place); points are kept in the estimate's frame. */
void camera_look(Planner *p, const float eye[3], const float shift[3], double yaw, const double *boxes, int n_boxes)
{
    const double x = (double)eye[0] + shift[0], y = (double)eye[1] + shift[1], z = (double)eye[2] + shift[2];
    double sine, cosine;
    Cloud *hits = &p->seen;
    hits->n = 0;
    exact_sincos(yaw, &sine, &cosine);
    for (int i = 0; i < p->set.columns; i++) {
        const double ux = cosine * p->ray_cos[i] - sine * p->ray_sin[i], uy = sine * p->ray_cos[i] + cosine * p->ray_sin[i];
        double enter[16], leave[16];
        int seen[16], n_seen = 0;
        for (int b = 0; b < n_boxes && n_seen < 16; b++)
            if (crossing(boxes + b * BOX_FIELDS, x, y, ux, uy, &enter[n_seen], &leave[n_seen]) && enter[n_seen] < p->set.range)
                seen[n_seen++] = b;
        const int ground_visible = z < (double)p->set.range;
        if (n_seen == 0 && !ground_visible)
            continue;
        for (int j = 0; j < p->set.rows; j++) {
            const double tan = p->ray_tan[j];
            double hit = tan < 0.0 ? -z / tan : 1e9;
            for (int k = 0; k < n_seen; k++) {
                const double at = meets(boxes + seen[k] * BOX_FIELDS, z, tan, enter[k], leave[k]);
                hit = at < hit ? at : hit;
            }
            const float range = (float)hit * p->ray_stretch[j];
            if (range > p->set.near && range < p->set.range) {
                hits->x[hits->n] = (float)(eye[0] + ux * hit);
                hits->y[hits->n] = (float)(eye[1] + uy * hit);
                hits->z[hits->n++] = (float)(eye[2] + tan * hit);
            }
        }
    }
    directions(p, hits, eye);
    for (int i = 0; i < hits->n; i++)
        add_point(p, hits, i, 0.0f);
}

/* True where the camera looks and the planner knows that it does; directions in degrees. */
static int in_view(const Planner *p, float azimuth, float elevation, float yaw_deg)
{
    float off = azimuth - yaw_deg;
    off -= 360.0f * floorf(off / 360.0f + 0.5f);
    return fabsf(off) <= p->set.half_h && fabsf(off - p->set.learnt_centre) <= p->set.learnt_half && fabsf(elevation) <= p->set.half_v;
}

/* New points first, one per fine cell; an old one stays if near, young, out of view and alone in its cell. */
void memory_update(Planner *p, const float eye[3], const float shift[3], double yaw, double now_s, const double *boxes,
                   int n_boxes)
{
    const float elapsed = (float)(now_s - p->looked_s), reach = p->set.range * p->set.range;
    const float yaw_deg = (float)(exact_wrap(yaw) / EXACT_RAD);
    Cloud *old = &p->older;
    const int n = p->cloud.n;
    memcpy(old->x, p->cloud.x, sizeof(float) * (size_t)n);
    memcpy(old->y, p->cloud.y, sizeof(float) * (size_t)n);
    memcpy(old->z, p->cloud.z, sizeof(float) * (size_t)n);
    memcpy(old->age_s, p->cloud.age_s, sizeof(float) * (size_t)n);
    old->n = n;
    p->cloud.n = 0;
    p->looked_s = now_s;
    memset(p->fine, 0, sizeof p->fine);
    camera_look(p, eye, shift, yaw, boxes, n_boxes);
    directions(p, old, eye);
    for (int i = 0; i < n; i++) {
        const float dx = old->x[i] - eye[0], dy = old->y[i] - eye[1], dz = old->z[i] - eye[2];
        if (dx * dx + dy * dy + dz * dz < reach && old->age_s[i] < p->set.memory_age &&
            !in_view(p, p->azimuth_of[i], p->elevation_of[i], yaw_deg))
            add_point(p, old, i, old->age_s[i] + elapsed);
    }
}
