/* Linear interpolation on a uniform grid, held beyond its ends. */
#include "runtime.h"

static void locate_in_table(const table_data *t, double x, int *index, double *weight, double *slope)
{
    double position = (x - t->first) / t->spacing;
    double last = (double)(t->points - 1);
    *slope = 1.0 / t->spacing;
    if (!(position > 0.0)) {
        position = 0.0;
        *slope = 0.0;
    } else if (position >= last) {
        position = last;
        *slope = 0.0;
    }
    *index = (int)position;
    if (*index > t->points - 2) *index = t->points - 2;
    *weight = position - *index;
}

void table_evaluate(const table_data *t, const double *x, double *result)
{
    for (int i = 0; i < t->arguments; i++) {
        int index;
        double weight, slope;
        locate_in_table(t, x[i], &index, &weight, &slope);
        const double *row = t->data + ((size_t)t->which[i] * t->points + index) * t->columns;
        for (int c = 0; c < t->columns; c++) *result++ = row[c] + weight * (row[c + t->columns] - row[c]);
    }
}

void table_forward(const table_data *t, const double *x, const double *dx, double *dresult)
{
    for (int i = 0; i < t->arguments; i++) {
        int index;
        double weight, slope;
        locate_in_table(t, x[i], &index, &weight, &slope);
        const double *row = t->data + ((size_t)t->which[i] * t->points + index) * t->columns;
        for (int c = 0; c < t->columns; c++) *dresult++ = slope * (row[c + t->columns] - row[c]) * dx[i];
    }
}
