/* A trace being written row by row: chosen slots of a vehicle's doubles. */
#ifndef SAFLITE_RECORDER_H
#define SAFLITE_RECORDER_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    float *rows;
    const int32_t *columns; /* places in the doubles given to `recorder_row` */
    int32_t column_count, row_limit, row_count, steps_per_row;
} Recorder;

static inline void recorder_row(Recorder *r, const double *from)
{
    if (r->rows == NULL || r->row_count >= r->row_limit)
        return;
    float *row = r->rows + (size_t)r->row_count * (size_t)r->column_count;
    for (int i = 0; i < r->column_count; i++)
        row[i] = (float)from[r->columns[i]];
    r->row_count++;
}

static inline void recorder_step(Recorder *r, const double *from, int64_t step)
{
    if (r->steps_per_row > 0 && step % r->steps_per_row == 0)
        recorder_row(r, from);
}

#endif
