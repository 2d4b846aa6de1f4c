/* Obstacles as boxes. One row of eight doubles each, as `flight.geometry.boxes_array` packs them:
 * x, y, half_length, half_width, cos r, sin r, z_base, z_top   (metres, counter-clockwise rotation r) */
#ifndef SAFLITE_BOXES_H
#define SAFLITE_BOXES_H

enum { BOX_X, BOX_Y, BOX_HALF_LENGTH, BOX_HALF_WIDTH, BOX_COS, BOX_SIN, BOX_BASE, BOX_TOP, BOX_FIELDS };

#define NO_OBSTACLE_M 1000.0

/* The competition's distance of a point: in the plane to the full boxes, or above the top when over a box. */
double boxes_distance(const double *boxes, int n_boxes, double x, double y, double z);

/* The same for n points of three doubles each; out receives n doubles. */
void boxes_distances(const double *boxes, int n_boxes, const double *points, int n, double *out);

/* Index of the box whose solid core (`scale` times its length and width) holds the point, -1 if none. */
int boxes_contact(const double *boxes, int n_boxes, double scale, double x, double y, double z);

#endif
