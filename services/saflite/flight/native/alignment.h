/* Shapes of tracks, as `flight.track_shape` makes them: SHAPE_POINTS places (x, y) in metres each. */
#ifndef SAFLITE_ALIGNMENT_H
#define SAFLITE_ALIGNMENT_H

enum { SHAPE_POINTS = 64 };

/* Mean gap in metres along the best alignment; infinite where it is sure to be more than `most`. */
double shapes_gap(const double *one, const double *other, double most);

/* Index of the first of the other shapes, one after the other, that is no farther away than `limit`; -1 if all are. */
int shapes_first_like(const double *one, const double *others, int n_others, double limit);

#endif
