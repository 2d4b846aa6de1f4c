/* How far two shapes are apart along their best alignment, by dynamic time warping (Sakoe and Chiba 1978).
 * Only + - * / and sqrt: books on any machine call the same finds one behaviour. */
#include "alignment.h"

#include <math.h>

/* Sum and steps of the best way so far: least in sum, of these least in steps. */
typedef struct {
    double sum;
    int steps;
} way;

static inline way better(way one, way other)
{
    return other.sum < one.sum || (other.sum == one.sum && other.steps < one.steps) ? other : one;
}

static inline double apart(const double *one, const double *other)
{
    const double dx = one[0] - other[0], dy = one[1] - other[1];
    return sqrt(dx * dx + dy * dy);
}

double shapes_gap(const double *one, const double *other, double most)
{
    const way none = {INFINITY, 2 * SHAPE_POINTS};
    way row[SHAPE_POINTS + 1]; /* ways to each place of the other shape; the first stands outside it */
    for (int j = 0; j <= SHAPE_POINTS; j++)
        row[j] = none;
    for (int i = 0; i < SHAPE_POINTS; i++) {
        way across = i ? none : (way){0.0, 0}; /* the way to the place before, of the row before */
        double least = INFINITY;
        row[0] = none;
        for (int j = 1; j <= SHAPE_POINTS; j++) {
            const way from = better(better(across, row[j]), row[j - 1]);
            across = row[j];
            row[j] = (way){from.sum + apart(one + 2 * i, other + 2 * (j - 1)), from.steps + 1};
            least = row[j].sum < least ? row[j].sum : least;
        }
        if (least > most * (2 * SHAPE_POINTS - 1))
            return INFINITY; /* in whatever steps it gets to the end, it is more */
    }
    return row[SHAPE_POINTS].sum / row[SHAPE_POINTS].steps;
}

int shapes_first_like(const double *one, const double *others, int n_others, double limit)
{
    for (int i = 0; i < n_others; i++)
        if (shapes_gap(one, others + 2 * SHAPE_POINTS * i, limit) <= limit)
            return i;
    return -1;
}
