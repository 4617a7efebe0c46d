/* Energy at mechanical ports: what one end got as work of the force it used, against what the other end gave. */
#include "kernel.h"

#include <math.h>

enum { POINTS = 3 }; /* of Simpson's rule: start, middle and end of the step */

static double bend_of(const Plan *p, int32_t v, double h)
{
    return 2.0 * (p->now[v] - 2.0 * p->mid[v] + p->next[v]) / (h * h);
}

/* Best knowledge of a value at the three points, now that both ends are known: the parabola through these and the value
 * before or, where steps are iterated, the value in the middle. */
static void best(const Plan *p, int32_t v, double h, double y[POINTS])
{
    y[0] = p->now[v];
    y[2] = p->next[v];
    if (p->scheme != SINGLE_PASS) {
        y[1] = p->mid[v];
        return;
    }
    y[1] = 0.5 * (y[0] + y[2]);
    if (p->history > 0) y[1] -= 0.25 * h * (y[2] - y[0] - h * p->rate[v]) / (h + p->last);
}

/* What an input was at the three points. `advance` left its polynomial at the step's end. */
static void used(const Plan *p, int32_t input, double h, double y[POINTS])
{
    const double slope = h * p->input_slope[input], bend = h * h * p->input_bend[input];
    y[2] = p->value[input];
    y[1] = y[2] - 0.5 * slope + 0.25 * bend;
    y[0] = y[2] - slope + bend;
}

/* Flow of a pair as the other end used it; as it was, where nothing is known of that. */
static void seen(const Plan *p, const Pair *q, double h, const double flow[POINTS], double y[POINTS])
{
    const int32_t i = q->flow_used;
    if (i >= 0 && !q->by_rate) {
        used(p, i, h, y);
        for (int k = 0; k < POINTS; ++k) y[k] = (y[k] - p->offset[i]) / p->factor[i];
    } else if (i >= 0 && p->order > 0) { /* positions that are held jump: nothing is known of the work then */
        for (int k = 0; k < POINTS; ++k) y[k] = (p->input_slope[i] + (k - 2) * h * p->input_bend[i]) / p->factor[i];
    } else {
        for (int k = 0; k < POINTS; ++k) y[k] = flow[k];
    }
}

/* Powers of a pair at the three points: as it was, and by how much the one end's differs from the other's. */
static void powers(const Plan *p, const Pair *q, double h, double power[POINTS], double error[POINTS])
{
    double effort[POINTS], flow[POINTS], effort_used[POINTS], flow_used[POINTS];
    best(p, p->source[q->effort], h, effort);
    best(p, q->flow, h, flow);
    used(p, q->effort, h, effort_used);
    seen(p, q, h, flow, flow_used);
    for (int k = 0; k < POINTS; ++k) {
        const double e = p->factor[q->effort] * effort[k] + p->offset[q->effort];
        power[k] = e * flow[k];
        error[k] = effort_used[k] * flow[k] - e * flow_used[k];
    }
}

/* Work at the other end where a position that it extrapolated is put right at the end of the step. */
static double jump_work(const Plan *p, const Pair *q)
{
    const int32_t i = q->flow_used;
    if (i < 0 || !q->by_rate || p->order == 0) return 0.0;
    const double effort = p->factor[q->effort] * p->next[p->source[q->effort]] + p->offset[q->effort];
    return effort * (p->next[p->source[i]] - (p->value[i] - p->offset[i]) / p->factor[i]);
}

/* Add this step to every port's energies. */
void measure_ports(Plan *p, double h)
{
    for (int32_t i = 0; i < p->n_pairs; ++i) {
        const Pair *q = &p->pairs[i];
        Port *port = &p->ports[q->port];
        double power[POINTS], error[POINTS];
        powers(p, q, h, power, error);
        port->crossed += h / 6.0 * (fabs(power[0]) + 4.0 * fabs(power[1]) + fabs(power[2]));
        port->residual += h / 6.0 * (error[0] + 4.0 * error[1] + error[2]) - jump_work(p, q);
        if (p->scheme != SINGLE_PASS) p->last_bend[i] = bend_of(p, p->source[q->effort], h);
    }
}

/* Error of a step not yet accepted: the largest share that the error of a pair's effort, as power, has of its port's mean
 * power. Of one pass it is the error of the extrapolation; of an iterated step, what a parabola cannot follow, by the
 * change of its curvature since the step before: a force that jumps within the step (an end stop) stands out by orders. */
double step_error(const Plan *p, double h)
{
    const double elapsed = p->time - p->start;
    double worst = 0.0;
    for (int32_t i = 0; i < p->n_pairs; ++i) {
        const Pair *q = &p->pairs[i];
        const int32_t s = p->source[q->effort];
        const double factor = p->factor[q->effort], effort = factor * p->next[s] + p->offset[q->effort];
        double error = p->value[q->effort] - effort; /* `advance` left the input at the step's end */
        if (p->scheme != SINGLE_PASS) {
            const double change = p->history > 0 ? bend_of(p, s, h) - p->last_bend[i] : 0.0;
            error = 0.125 * h * h * factor * change;
        }
        const double flow = p->next[q->flow], mean = elapsed > 0.0 ? p->ports[q->port].crossed / elapsed : 0.0;
        const double wrong = fabs(error * flow), now = fabs(effort * flow), reference = now > mean ? now : mean;
        if (wrong > worst * reference && reference > 0.0) worst = wrong / reference;
    }
    return worst;
}
