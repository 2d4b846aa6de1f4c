/* Obstacles as boxes. One row of eight doubles each, as `flight.geometry.boxes_array` packs them:
 * x, y, half_length, half_width, cos r, sin r, z_base, z_top   (metres, counter-clockwise rotation r) */
#ifndef SAFLITE_BOXES_H
#define SAFLITE_BOXES_H

enum { BOX_X, BOX_Y, BOX_HALF_LENGTH, BOX_HALF_WIDTH, BOX_COS, BOX_SIN, BOX_BASE, BOX_TOP, BOX_FIELDS };

#include <math.h>

#define NO_OBSTACLE_M 1000.0

/* Distance in the plane to a box with half sides scaled by `scale`; 0 inside. */
static inline double box_plane_distance(const double *box, double scale, double x, double y)
{
    const double dx = x - box[BOX_X], dy = y - box[BOX_Y];
    const double along = fabs(dx * box[BOX_COS] + dy * box[BOX_SIN]) - scale * box[BOX_HALF_LENGTH];
    const double across = fabs(dy * box[BOX_COS] - dx * box[BOX_SIN]) - scale * box[BOX_HALF_WIDTH];
    const double u = along > 0.0 ? along : 0.0, v = across > 0.0 ? across : 0.0;
    return sqrt(u * u + v * v);
}

/* The competition's distance of a point: in the plane to the full boxes, or above the top when over a box. */
double boxes_distance(const double *boxes, int n_boxes, double x, double y, double z);

/* The same for n points of three doubles each; out receives n doubles. */
void boxes_distances(const double *boxes, int n_boxes, const double *points, int n, double *out);

/* Index of the box whose solid core (`scale` times its length and width) holds the point, -1 if none. */
int boxes_contact(const double *boxes, int n_boxes, double scale, double x, double y, double z);

#endif
