/* One component: set its inputs, let it step, read its outputs, save and restore its state. */
#include "kernel.h"

#include <math.h>

int fail(Plan *p, int32_t member, int32_t cause, int32_t value, fmi2Status status)
{
    p->cause = cause;
    p->failed_member = member;
    p->failed_value = value;
    p->status = (int32_t)status;
    return 0;
}

int bad(fmi2Status status) { return status != fmi2OK && status != fmi2Warning; }

static int set_reals(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    const size_t n = (size_t)m->inputs[REALS];
    if (n == 0) return 1;
    fmi2Status s = m->set_real(m->instance, p->input_reference + m->first_input, n, p->value + m->first_input);
    return bad(s) ? fail(p, member, SET_FAILED, -1, s) : 1;
}

/* Give a component the present `value` of each of its inputs. */
int set_member(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    int32_t first = m->first_input + m->inputs[REALS];
    for (int type = INTEGERS; type <= BOOLEANS; ++type) {
        const int32_t n = m->inputs[type];
        if (n == 0) continue;
        const int wide = type == INTEGERS && !m->set_integer;
        for (int32_t i = 0; i < n; ++i) {
            const double given = p->value[first + i], v = type == BOOLEANS ? given != 0.0 : round(given);
            p->value[first + i] = v;
            if (!wide && !(fabs(v) <= INT32_MAX)) {
                p->failed_number = v;
                return fail(p, member, SET_FAILED, first + i, fmi2Error);
            }
            if (!wide) p->integers[i] = (int32_t)v;
        }
        const uint32_t *references = p->input_reference + first;
        fmi2Status s = wide               ? m->set_real(m->instance, references, (size_t)n, p->value + first)
                       : type == INTEGERS ? m->set_integer(m->instance, references, (size_t)n, p->integers)
                                          : m->set_boolean(m->instance, references, (size_t)n, p->integers);
        if (bad(s)) return fail(p, member, SET_FAILED, -1, s);
        first += n;
    }
    return set_reals(p, member);
}

int read_member(Plan *p, int32_t member, double *y)
{
    Member *m = &p->members[member];
    int32_t first = m->first_read;
    for (int type = REALS; type < TYPES; ++type) {
        const int32_t n = m->reads[type];
        if (n == 0) continue;
        const uint32_t *references = p->read_reference + first;
        const int real = type == REALS || (type == INTEGERS && !m->get_integer);
        fmi2Status s = real               ? m->get_real(m->instance, references, (size_t)n, y + first)
                       : type == INTEGERS ? m->get_integer(m->instance, references, (size_t)n, p->integers)
                                          : m->get_boolean(m->instance, references, (size_t)n, p->integers);
        if (bad(s)) return fail(p, member, GET_FAILED, -1, s);
        for (int32_t i = 0; !real && i < n; ++i) y[first + i] = (double)p->integers[i];
        first += n;
    }
    return 1;
}

int check_member(Plan *p, int32_t member, const double *y)
{
    const Member *m = &p->members[member];
    for (int32_t i = m->first_read; i < m->first_read + m->reads[REALS]; ++i)
        if (!(fabs(y[i]) <= p->limit[i])) {
            p->failed_number = y[i];
            return fail(p, member, NOT_FINITE, i, fmi2OK);
        }
    return 1;
}

static int set_derivatives(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    const size_t n = (size_t)m->varying;
    const uint32_t *references = p->input_reference + m->first_input;
    if (n == 0 || (p->order == 0 && p->scheme == SINGLE_PASS)) return 1;
    fmi2Status s = m->set_slopes(m->instance, references, n, p->first_order, p->input_slope + m->first_input);
    if (!bad(s) && (p->order == 2 || p->scheme != SINGLE_PASS)) {
        for (size_t i = 0; i < n; ++i) p->derivatives[i] = 2.0 * p->input_bend[(size_t)m->first_input + i];
        s = m->set_slopes(m->instance, references, n, p->second_order, p->derivatives);
    }
    return bad(s) ? fail(p, member, SLOPE_FAILED, -1, s) : 1;
}

/* Move the polynomials of the varying inputs: their `value` and slope are then those `tau` later. */
static void shift(Plan *p, const Member *m, double tau)
{
    for (int32_t i = m->first_input; i < m->first_input + m->varying; ++i) {
        p->value[i] += tau * (p->input_slope[i] + tau * p->input_bend[i]);
        p->input_slope[i] += 2.0 * tau * p->input_bend[i];
    }
}

/* One fmi2DoStep over `span`, with the inputs' polynomials; leaves these, and the component's inputs, at its end. */
int advance(Plan *p, int32_t member, double time, double span)
{
    Member *m = &p->members[member];
    const int32_t first = m->first_input, end = m->first_input + m->varying;
    if (m->set_slopes) {
        if (!set_member(p, member) || !set_derivatives(p, member)) return 0;
    } else { /* a component that holds its inputs gets their mean: the same impulse as the polynomial would give */
        double *kept = p->derivatives;
        for (int32_t i = first; i < end; ++i) {
            kept[i - first] = p->value[i];
            p->value[i] += span * (0.5 * p->input_slope[i] + span / 3.0 * p->input_bend[i]);
        }
        if (!set_member(p, member)) return 0;
        for (int32_t i = first; i < end; ++i) p->value[i] = kept[i - first];
    }
    const int final = p->energy_tolerance == 0.0 && p->scheme == SINGLE_PASS && (p->history > 0 || !p->reversible);
    fmi2Status s = m->do_step(m->instance, time, span, final ? fmi2True : fmi2False);
    if (bad(s)) return fail(p, member, STEP_FAILED, -1, s);
    shift(p, m, span);
    return set_reals(p, member); /* outputs with direct feed-through are to see the inputs of the step's end */
}

int save_member(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    fmi2Status s = m->get_state(m->instance, &m->saved);
    return bad(s) ? fail(p, member, SAVE_FAILED, -1, s) : 1;
}

int restore_member(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    fmi2Status s = m->set_state(m->instance, m->saved);
    return bad(s) ? fail(p, member, RESTORE_FAILED, -1, s) : 1;
}
