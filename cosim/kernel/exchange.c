/* At a communication point: outputs that follow inputs directly see these as they are now, and algebraic loops are solved.
 *
 * One sweep over the components concerned leaves inputs whose source comes later in the order to be corrected: by
 * Newton's method for those on loops (with the Jacobian of the sweep, kept from one communication point to the next),
 * by substitution for the others.
 */
#include "kernel.h"

#include <math.h>
#include <string.h>

enum { MOST_SWEEPS = 30, PATIENCE = 4, KEPT = 40 }; /* KEPT: steps that a Jacobian which still serves is kept at least */
static const double STRONG = 0.3;

/* Set and read the components concerned, with `used` for the inputs whose source comes later; `now` is what they give. */
static int sweep(Plan *p, const double *used)
{
    p->sweeps += 1;
    for (int32_t k = 0; k < p->n_members; ++k) {
        Member *m = &p->members[k];
        if (!m->stale) continue;
        const double begin = p->timed ? seconds_now() : 0.0;
        present_inputs(p, m);
        const int32_t end = m->first_input + m->inputs[REALS] + m->inputs[INTEGERS] + m->inputs[BOOLEANS];
        for (int32_t j = 0; j < p->n_backward; ++j)
            if (p->backward[j] >= m->first_input && p->backward[j] < end) p->value[p->backward[j]] = used[j];
        if (!set_member(p, k) || !read_member(p, k, p->now)) return 0;
        if (p->timed) m->seconds += seconds_now() - begin;
    }
    return 1;
}

/* Magnitude by which the error of an input is judged. */
double scale_of(const Plan *p, int32_t input, double value)
{
    const double nominal = fabs(p->factor[input]) * p->scale[p->source[input]];
    return fabs(value) > nominal ? fabs(value) : nominal;
}

/* Whether a component takes part in loops as they are solved now: in an exchange, or in an iteration. */
static int in_loops(const Plan *p, int32_t member)
{
    const Member *m = &p->members[member];
    return m->stale || (p->scheme == NEWTON && m->iterated);
}

/* Response of the inputs on loops to a change of each of them, by the FMUs' directional derivatives. */
static int directional_column(Plan *p, int32_t column)
{
    double *du = p->seed, *dy = p->response;
    memset(du, 0, (size_t)p->n_inputs * sizeof *du);
    memset(dy, 0, (size_t)p->n_values * sizeof *dy);
    du[p->tear[column]] = 1.0;
    for (int32_t k = 0; k < p->n_members; ++k) {
        Member *m = &p->members[k];
        const int32_t n = m->inputs[REALS], first = m->first_input;
        int moved = 0;
        if (!in_loops(p, k)) continue;
        for (int32_t i = first; i < first + n; ++i) {
            if (i == p->tear[column]) moved = 1;
            else if (p->owner[p->source[i]] < k) du[i] = p->factor[i] * dy[p->source[i]];
            moved |= du[i] != 0.0;
        }
        if (!moved) continue;
        fmi2Status s = m->directional(m->instance, p->read_reference + m->first_read, (size_t)m->derived,
                                      p->input_reference + first, (size_t)n, du + first, dy + m->first_read);
        if (bad(s)) return fail(p, k, DERIVATIVE_FAILED, -1, s);
    }
    for (int32_t j = 0; j < p->n_tear; ++j)
        p->jacobian[j * p->n_tear + column] = p->factor[p->tear[j]] * dy[p->source[p->tear[j]]];
    return 1;
}

/* The same by a finite difference, for FMUs without derivatives. `base`: inputs in use; `now` is what they give. */
static int difference_column(Plan *p, int32_t column, const double *base)
{
    double *used = p->seed, *now = p->response;
    memcpy(now, p->now, (size_t)p->n_values * sizeof *now);
    memcpy(used, base, (size_t)p->n_backward * sizeof *used);
    double change = 0.0;
    for (int32_t j = 0; j < p->n_backward; ++j)
        if (p->backward[j] == p->tear[column]) {
            change = 1e-3 * scale_of(p, p->tear[column], used[j]); /* large: the loops in mechanics are affine */
            used[j] += change;
        }
    if (!sweep(p, used)) return 0;
    for (int32_t j = 0; j < p->n_tear; ++j) {
        const int32_t s = p->source[p->tear[j]];
        p->jacobian[j * p->n_tear + column] = p->factor[p->tear[j]] * (p->now[s] - now[s]) / change;
    }
    memcpy(p->now, now, (size_t)p->n_values * sizeof *now);
    return 1;
}

static int is_backward(const Plan *p, int32_t input)
{
    for (int32_t j = 0; j < p->n_backward; ++j)
        if (p->backward[j] == input) return 1;
    return 0;
}

int find_jacobian(Plan *p, const double *base)
{
    int by_derivatives = 1;
    for (int32_t k = 0; k < p->n_members; ++k) by_derivatives &= !in_loops(p, k) || p->members[k].directional != NULL;
    for (int32_t column = 0; column < p->n_tear; ++column) {
        if (by_derivatives && in_loops(p, p->target[p->tear[column]]) && !directional_column(p, column)) return 0;
        if (!by_derivatives && base && is_backward(p, p->tear[column]) && !difference_column(p, column, base)) return 0;
    }
    p->jacobian_known = 1;
    p->jacobian_attempts = p->attempts;
    p->gain = 0.0;
    for (int32_t row = 0; row < p->n_tear; ++row) {
        double sum = 0.0;
        for (int32_t column = 0; column < p->n_tear; ++column) sum += fabs(p->jacobian[row * p->n_tear + column]);
        if (sum > p->gain) p->gain = sum;
    }
    return 1;
}

/* x = (1 - J)^-1 x in place, by elimination with pivots; equations without solution leave x as it is. */
static void solve(Plan *p, double *x)
{
    const int32_t n = p->n_tear;
    double *a = p->matrix, *given = p->correction;
    for (int32_t i = 0; i < n * n; ++i) a[i] = (i % (n + 1) == 0) - p->jacobian[i];
    memcpy(given, x, (size_t)n * sizeof *x);
    for (int32_t c = 0; c < n; ++c) {
        int32_t pivot = c;
        for (int32_t r = c + 1; r < n; ++r)
            if (fabs(a[r * n + c]) > fabs(a[pivot * n + c])) pivot = r;
        if (!(fabs(a[pivot * n + c]) > 1e-14)) {
            memcpy(x, given, (size_t)n * sizeof *x);
            return;
        }
        for (int32_t j = 0; pivot != c && j < n; ++j) {
            const double held = a[c * n + j];
            a[c * n + j] = a[pivot * n + j];
            a[pivot * n + j] = held;
        }
        const double held = x[c];
        x[c] = x[pivot];
        x[pivot] = held;
        for (int32_t r = c + 1; r < n; ++r) {
            const double f = a[r * n + c] / a[c * n + c];
            if (f == 0.0) continue;
            for (int32_t j = c; j < n; ++j) a[r * n + j] -= f * a[c * n + j];
            x[r] -= f * x[c];
        }
    }
    for (int32_t r = n - 1; r >= 0; --r) {
        for (int32_t j = r + 1; j < n; ++j) x[r] -= a[r * n + j] * x[j];
        x[r] /= a[r * n + r];
    }
}

/* Correct what was used for n inputs by its residual: by Newton's method on loops (`place`: among the tears, or -1). */
void correct(Plan *p, const int32_t *place, int32_t n, double *used, const double *residual)
{
    double *x = p->correction + p->n_tear;
    memset(x, 0, (size_t)p->n_tear * sizeof *x);
    for (int32_t j = 0; j < n; ++j)
        if (place[j] >= 0) x[place[j]] = residual[j];
    if (p->n_tear > 0) solve(p, x);
    for (int32_t j = 0; j < n; ++j) used[j] += place[j] >= 0 ? x[place[j]] : residual[j];
}

/* Make all outputs consistent with the inputs of this instant. */
int exchange(Plan *p)
{
    double *used = p->end_used, *residual = p->end_before;
    double before = HUGE_VAL;
    int32_t worst = -1, patience = 0;
    for (int32_t j = 0; j < p->n_backward; ++j) used[j] = present(p, p->backward[j]);
    for (int32_t i = 0; i < MOST_SWEEPS; ++i) {
        if (!sweep(p, used)) return 0;
        double largest = 0.0;
        for (int32_t j = 0; j < p->n_backward; ++j) {
            const int32_t input = p->backward[j];
            const double given = present(p, input), error = fabs(given - used[j]) / scale_of(p, input, given);
            residual[j] = given - used[j];
            if (!(error <= largest) && !isnan(largest)) {
                largest = error;
                worst = input;
            }
        }
        if (largest <= p->tolerance) return 1;
        const int poor = largest > 0.5 * before && ++patience >= PATIENCE;
        const int aged = i > 0 && p->attempts - p->jacobian_attempts > KEPT; /* two sweeps would do with a new one */
        if (p->n_tear > 0 && (!p->jacobian_known || poor || aged)) {
            patience = 0;
            if (!find_jacobian(p, used)) return 0;
        }
        before = largest;
        correct(p, p->backward_tear, p->n_backward, used, residual);
    }
    return fail(p, p->owner[p->source[worst]], LOOP_OPEN, worst, fmi2OK);
}

/* The same for the values that a step gave, before anything sampled at its end counts: loops of strong gain amplify the
 * error of extrapolated inputs, and slopes taken from such values would make it grow from step to step. */
int exchange_left(Plan *p, double h)
{
    double *left = p->mid, *now = p->now;
    if (p->scheme != SINGLE_PASS || p->order == 0 || p->gain < STRONG) return 1;
    memcpy(left, p->next, (size_t)p->n_values * sizeof *left);
    for (int32_t i = 0; i < p->n_inputs; ++i)
        if (p->mode[i] == HELD) left[p->source[i]] = now[p->source[i]];
    for (int32_t k = 0; p->slow && k < p->n_members; ++k) { /* what steps at multiples: as it is at the end of this step */
        Member *m = &p->members[k];
        const size_t first = (size_t)m->first_read, n = (size_t)(m->reads[REALS] + m->reads[INTEGERS] + m->reads[BOOLEANS]);
        if (m->phase + 1 < m->every) memcpy(left + first, now + first, n * sizeof *left);
        m->age = m->phase + 1 < m->every ? h * (m->phase + 1) : 0.0;
    }
    p->now = left;
    const int fine = exchange(p);
    p->now = now;
    if (!fine) return 0;
    for (int32_t k = 0; k < p->n_members; ++k) {
        const Member *m = &p->members[k];
        const size_t first = (size_t)m->first_read;
        if (m->stale) memcpy(p->next + first, left + first, (size_t)m->derived * sizeof *left);
    }
    return 1;
}
