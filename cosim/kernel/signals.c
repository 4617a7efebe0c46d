/* Signals between the communication points: what inputs are over a step, from what their sources were before and after. */
#include "kernel.h"

void present_inputs(Plan *p, const Member *m)
{
    const int32_t end = m->first_input + m->inputs[REALS] + m->inputs[INTEGERS] + m->inputs[BOOLEANS];
    for (int32_t i = m->first_input; i < end; ++i) p->value[i] = present(p, i);
}

/* Inputs of a component that steps at multiples: linear from the start of its own step to the end of this one. */
static void inputs_over_own_step(Plan *p, const Member *m, double h)
{
    for (int32_t i = m->first_input; i < m->first_input + m->varying; ++i) {
        const int32_t s = p->source[i];
        const double age = p->members[p->owner[s]].age + h;
        const double y = p->mode[i] == INTERPOLATED ? p->next[s] : p->now[s] + age * (p->slope[s] + age * p->bend[s]);
        const double end = p->factor[i] * y + p->offset[i];
        p->value[i] = p->begun[i];
        p->input_slope[i] = p->order == 0 ? 0.0 : (end - p->begun[i]) / (h * m->every);
        p->input_bend[i] = 0.0;
    }
}

/* Polynomials of a component's inputs over the step, by each input's mode and the chosen order. */
void inputs_over_step(Plan *p, const Member *m, double h)
{
    const int32_t varying = m->first_input + m->varying;
    present_inputs(p, m);
    if (m->every > 1) {
        inputs_over_own_step(p, m, h);
        return;
    }
    for (int32_t i = m->first_input; i < varying; ++i) {
        const int32_t s = p->source[i];
        double slope = p->slope[s], bend = p->bend[s]; /* EXTRAPOLATED */
        if (p->mode[i] == INTERPOLATED && p->order == 0) {
            p->value[i] = p->factor[i] * p->next[s] + p->offset[i];
            slope = bend = 0.0;
        } else if (p->mode[i] == INTERPOLATED) { /* through the values at both ends and, with order 2, the one before */
            slope = (p->next[s] - p->now[s]) / h;
            bend = p->order == 2 && p->history > 0 ? (slope - p->rate[s]) / (h + p->last) : 0.0;
            slope -= h * bend;
        } else if (p->slow) {
            slope += 2.0 * p->members[p->owner[s]].age * bend;
        }
        p->input_slope[i] = p->factor[i] * slope;
        p->input_bend[i] = p->factor[i] * bend;
    }
}

/* Take the values at the step's end as those of the next start, with the slopes to extrapolate them (Newton's form:
 * divided differences over the steps before, taken between the limits within each, since values may jump between). */
void accept_values(Plan *p, double h)
{
    for (int32_t k = 0; k < p->n_members; ++k) {
        const Member *m = &p->members[k];
        const int32_t varying = m->first_read + m->reads[REALS];
        const int32_t end = varying + m->reads[INTEGERS] + m->reads[BOOLEANS];
        if (m->phase != 0) continue; /* has not stepped yet */
        const double span = h * m->every;
        const double per_span = 1.0 / span;
        const double per_both = p->order == 2 && p->history > 0 && m->every == 1 ? 1.0 / (span + p->last) : 0.0;
        for (int32_t v = m->first_read; v < varying; ++v) {
            const double rate = (p->next[v] - p->now[v]) * per_span;
            const double bend = (rate - p->rate[v]) * per_both;
            p->slope[v] = p->order == 0 ? 0.0 : rate + span * bend;
            p->bend[v] = bend;
            p->rate[v] = rate;
            p->now[v] = p->next[v];
        }
        for (int32_t v = varying; v < end; ++v) p->now[v] = p->next[v];
    }
    p->last = h;
    p->history += p->history < 2;
}
