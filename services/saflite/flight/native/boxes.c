/* Distance and contact between a point and rotated boxes. */
#include "boxes.h"

static double one_distance(const double *box, double x, double y, double z)
{
    const double plane = box_plane_distance(box, 1.0, x, y);
    return plane == 0.0 && z > box[BOX_TOP] ? z - box[BOX_TOP] : plane;
}

double boxes_distance(const double *boxes, int n_boxes, double x, double y, double z)
{
    double least = NO_OBSTACLE_M;
    for (int i = 0; i < n_boxes; i++) {
        const double distance = one_distance(boxes + i * BOX_FIELDS, x, y, z);
        least = distance < least ? distance : least;
    }
    return least;
}

void boxes_distances(const double *boxes, int n_boxes, const double *points, int n, double *out)
{
    for (int i = 0; i < n; i++)
        out[i] = boxes_distance(boxes, n_boxes, points[3 * i], points[3 * i + 1], points[3 * i + 2]);
}

int boxes_contact(const double *boxes, int n_boxes, double scale, double x, double y, double z)
{
    for (int i = 0; i < n_boxes; i++) {
        const double *box = boxes + i * BOX_FIELDS, dx = x - box[BOX_X], dy = y - box[BOX_Y];
        const double along = fabs(dx * box[BOX_COS] + dy * box[BOX_SIN]);
        const double across = fabs(dy * box[BOX_COS] - dx * box[BOX_SIN]);
        if (along < scale * box[BOX_HALF_LENGTH] && across < scale * box[BOX_HALF_WIDTH] && z < box[BOX_TOP] &&
            z > box[BOX_BASE])
            return i;
    }
    return -1;
}
