/* Iterated coupling: a step is repeated from its saved start until what the components used is what they then gave.
 *
 * Between t_n and t_n+1 every varying input is the parabola through its source's values at the start, the middle and the
 * end; components take two steps of half the length. Inputs whose source comes later in the order are the unknowns, at
 * the middle and at the end. They are corrected by substitution with Aitken's relaxation (FIXED_POINT), or by Newton's
 * method with the Jacobian of the direct feed-through (NEWTON; what passes through states changes by O(h) only).
 */
#include "kernel.h"

#include <math.h>

enum { MOST_ITERATIONS = 40, PATIENCE = 5 };

/* Parabola of an input over the step from its values at the start, the middle and the end. */
static void parabola(Plan *p, int32_t input, double start, double middle, double end, double h)
{
    p->value[input] = start;
    p->input_slope[input] = (4.0 * middle - 3.0 * start - end) / h;
    p->input_bend[input] = 2.0 * (start - 2.0 * middle + end) / (h * h);
}

/* Inputs of a component from `mid` and `next`, or from what is assumed for those whose source comes later. */
static void iterated_inputs(Plan *p, const Member *m, double h)
{
    present_inputs(p, m);
    for (int32_t i = m->first_input; i < m->first_input + m->varying; ++i) {
        const int32_t s = p->source[i];
        parabola(p, i, p->value[i], p->factor[i] * p->mid[s] + p->offset[i], p->factor[i] * p->next[s] + p->offset[i], h);
    }
    for (int32_t j = 0; j < p->n_late; ++j) {
        const int32_t i = p->late[j];
        if (i >= m->first_input && i < m->first_input + m->varying)
            parabola(p, i, p->value[i], p->mid_used[j], p->end_used[j], h);
    }
}

static int half_step(Plan *p, int32_t member, double begin, double h)
{
    const int32_t n = p->members[member].substeps;
    const double span = 0.5 * h / n;
    for (int32_t i = 0; i < n; ++i)
        if (!advance(p, member, begin + i * span, span)) return 0;
    return 1;
}

static int pass(Plan *p, double h, int first)
{
    for (int32_t k = 0; k < p->n_members; ++k) {
        Member *m = &p->members[k];
        if (!m->iterated) continue;
        const double begin = p->timed ? seconds_now() : 0.0;
        if (!first && !restore_member(p, k)) return 0;
        iterated_inputs(p, m, h);
        if (!half_step(p, k, p->time, h) || !read_member(p, k, p->mid)) return 0;
        if (!half_step(p, k, p->time + 0.5 * h, h) || !read_member(p, k, p->next)) return 0;
        if (!check_member(p, k, p->next)) return 0;
        if (p->timed) m->seconds += seconds_now() - begin;
    }
    return 1;
}

/* Residuals at the middle and the end of each unknown; returns the largest, relative. */
static double residuals(Plan *p, double *middle, double *end, int32_t *worst)
{
    double largest = 0.0;
    for (int32_t j = 0; j < p->n_late; ++j) {
        const int32_t i = p->late[j], s = p->source[i];
        const double m = p->factor[i] * p->mid[s] + p->offset[i], e = p->factor[i] * p->next[s] + p->offset[i];
        middle[j] = m - p->mid_used[j];
        end[j] = e - p->end_used[j];
        const double error = (fabs(middle[j]) + fabs(end[j])) / scale_of(p, i, e);
        if (!(error <= largest) && !isnan(largest)) {
            largest = error;
            *worst = i;
        }
    }
    return largest;
}

/* Aitken's factor for the next correction, from this residual and the one before (scaled alike). */
static double relaxation(const Plan *p, double factor, const double *middle, const double *end)
{
    double along = 0.0, squares = 0.0;
    for (int32_t j = 0; j < p->n_late; ++j) {
        const double scale = scale_of(p, p->late[j], p->end_used[j]);
        const double dm = (middle[j] - p->mid_before[j]) / scale, de = (end[j] - p->end_before[j]) / scale;
        along += (p->mid_before[j] * dm + p->end_before[j] * de) / scale;
        squares += dm * dm + de * de;
    }
    if (!(squares > 0.0)) return factor;
    factor *= -along / squares;
    return factor > 0.05 && factor < 20.0 ? factor : 1.0;
}

/* Take one step of length h with all members; the step is not accepted yet. */
int iterate(Plan *p, double h)
{
    double *middle = p->derivatives, *end = p->derivatives + p->n_late, factor = 1.0;
    int32_t worst = -1;
    for (int32_t j = 0; j < p->n_late; ++j) {
        const int32_t i = p->late[j], s = p->source[i];
        const double half = 0.5 * h, f = p->factor[i];
        p->mid_used[j] = present(p, i) + f * half * (p->slope[s] + half * p->bend[s]);
        p->end_used[j] = present(p, i) + f * h * (p->slope[s] + h * p->bend[s]);
    }
    int done = 0;
    for (int i = 0; i < MOST_ITERATIONS && !done; ++i) {
        if (!pass(p, h, i == 0)) {
            if (p->cause == NOT_FINITE && worst >= 0) break; /* diverged: the iteration's fault, not the component's */
            return 0;
        }
        p->iterations += 1;
        const double error = residuals(p, middle, end, &worst);
        if (!(error > p->tolerance)) {
            done = 1;
        } else if (p->scheme == NEWTON && p->jacobian_known) {
            if (i % PATIENCE == PATIENCE - 1 && p->n_tear > 0 && !find_jacobian(p, NULL)) return 0;
            correct(p, p->late_tear, p->n_late, p->mid_used, middle);
            correct(p, p->late_tear, p->n_late, p->end_used, end);
        } else {
            if (i > 0) factor = relaxation(p, factor, middle, end);
            for (int32_t j = 0; j < p->n_late; ++j) {
                p->mid_before[j] = middle[j];
                p->end_before[j] = end[j];
                p->mid_used[j] += factor * middle[j];
                p->end_used[j] += factor * end[j];
            }
        }
    }
    if (!done) return fail(p, p->owner[p->source[worst]], NOT_CONVERGED, worst, fmi2OK);
    for (int32_t k = 0; k < p->n_members; ++k) { /* sampled components: what they give matters from the end on only */
        Member *m = &p->members[k];
        if (m->iterated) continue;
        const double begin = p->timed ? seconds_now() : 0.0;
        iterated_inputs(p, m, h);
        if (!advance(p, k, p->time, h) || !read_member(p, k, p->next) || !check_member(p, k, p->next)) return 0;
        if (p->timed) m->seconds += seconds_now() - begin;
    }
    return 1;
}
