/* Classical Runge-Kutta with sub-steps of at most `internal_step`, which end where a switch changes sign.
 *
 * Over a sub-step the switches' results are held, so that its formula sees smooth equations: the order of
 * convergence is kept across end stops and the like. */
#include <math.h>
#include <string.h>

#include "instance.h"

#define CROSSING_TOLERANCE 1e-10 /* of the sub-step: how far past a zero it ends */
#define MAX_ITERATIONS 60
#define MAX_CROSSINGS 20         /* in one sub-step; the rest of it is then taken as it comes */

typedef struct {
    instance *m;
    const double *u; /* inputs at the communication step's begin */
    double begin, t;
    const casadi_real *arg[MAX_ARGUMENTS]; /* of the equations: t is the member above */
} solver;

static int rate(solver *s, double t, const double *x, double *dx)
{
    instance *m = s->m;
    casadi_real *result[MAX_ARGUMENTS];
    result[0] = dx;
    s->t = t;
    s->arg[X] = x;
    if (model.n_u) inputs_at(m, s->u, s->begin, t);
    if (model.n_lookups && look_up(m, s->arg, FOR_RATES)) return 1;
    model.derivatives.evaluate(s->arg, result, m->iwork, m->work, 0);
    return 0;
}

/* The step of length h, whose first stage k[0] is known, to y. */
static int advance(solver *s, double t, double h, const double *x, double *k, double *y)
{
    int n = model.n_x;
    double *k1 = k, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, half = 0.5 * h, sixth = h / 6.0;
    for (int j = 0; j < n; j++) y[j] = x[j] + half * k1[j];
    if (rate(s, t + half, y, k2)) return 1;
    for (int j = 0; j < n; j++) y[j] = x[j] + half * k2[j];
    if (rate(s, t + half, y, k3)) return 1;
    for (int j = 0; j < n; j++) y[j] = x[j] + h * k3[j];
    if (rate(s, t + h, y, k4)) return 1;
    for (int j = 0; j < n; j++) y[j] = x[j] + sixth * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
    return 0;
}

static int signs_at(solver *s, double t, const double *x, double *result)
{
    s->t = t;
    s->arg[X] = x;
    if (model.n_u) inputs_at(s->m, s->u, s->begin, t);
    if (model.n_lookups && look_up(s->m, s->arg, FOR_SIGNS)) return 1;
    call(s->m, &model.switches, s->arg, result, NULL);
    return 0;
}

static double *held(const instance *m, int i) { return &m->values[AT_W + model.switches_at[i]]; }

void hold(const instance *m, const double *signs)
{
    for (int i = 0; i < model.n_switches; i++) *held(m, i) = signs[i] > 0.0;
}

int differ(const instance *m, const double *now)
{
    int different = 0;
    for (int i = 0; i < model.n_switches; i++) different |= (now[i] > 0.0) != (*held(m, i) > 0.0);
    return different;
}

/* The same of one switch; what stays at zero, or returns to it, is let be. */
static int crossed(const instance *m, int i, const double *now, const double *before)
{
    return (now[i] > 0.0) != (*held(m, i) > 0.0) && before[i] != 0.0;
}

static int any_crossed(const instance *m, const double *now, const double *before)
{
    for (int i = 0; i < model.n_switches; i++)
        if (crossed(m, i, now, before)) return 1;
    return 0;
}

/* Shorten the step of length *h from x to y to the one that ends just past the first crossing (Illinois' method).
 * before, after: the switches at x and y; trial: room for two arrays of these; other: room for a state. */
static int locate(solver *s, double t, double *h, const double *x, double *k, double *y, double *other,
                  const double *before, double *after, double *trial)
{
    instance *m = s->m;
    int n = model.n_switches, side = 0, slow = 0;
    double *at_a = trial + n, a = 0.0, b = *h, weight_a = 1.0, weight_b = 1.0;
    const double tolerance = CROSSING_TOLERANCE * *h;
    memcpy(at_a, before, n * sizeof(double));
    for (int i = 0; i < MAX_ITERATIONS; i++) {
        double width = b - a, fraction = 1.0;
        for (int j = 0; j < n; j++) {
            if (!crossed(m, j, after, before)) continue;
            double va = weight_a * at_a[j], zero = va / (va - weight_b * after[j]);
            if (zero < fraction) fraction = zero;
        }
        double zero = a + width * fraction;
        if (b - zero <= tolerance) break;
        double length = slow < 3 ? zero + 0.5 * tolerance : 0.5 * (a + b);
        if (advance(s, t, length, x, k, other) || signs_at(s, t + length, other, trial)) return 1;
        if (any_crossed(m, trial, before)) {
            b = length;
            memcpy(y, other, model.n_x * sizeof(double));
            memcpy(after, trial, n * sizeof(double));
            weight_a *= side == 1 ? 0.5 : 1.0;
            weight_b = 1.0;
            side = 1;
        } else {
            a = length;
            memcpy(at_a, trial, n * sizeof(double));
            weight_b *= side == -1 ? 0.5 : 1.0;
            weight_a = 1.0;
            side = -1;
        }
        slow = b - a > 0.5 * width ? slow + 1 : 0;
    }
    *h = b;
    return 0;
}

int depart(const instance *m, const double *before, const double *after)
{
    int any = 0;
    for (int i = 0; i < model.n_switches; i++) {
        if (before[i] != 0.0 || (after[i] > 0.0) == (*held(m, i) > 0.0)) continue;
        *held(m, i) = after[i] > 0.0;
        any = 1;
    }
    return any;
}

/* A sub-step of length h from and to x, in as many parts as there are crossings. before: the switches at x, held. */
static int sub_step(solver *s, double t, double h, double *x, double *k, double *before)
{
    instance *m = s->m;
    int n = model.n_x, n_s = model.n_switches;
    double *y = k + 4 * n, *other = y + n, *after = before + n_s, *trial = after + n_s, done = 0.0;
    for (int crossing = 0; done < h; crossing++) {
        double left = h - done, now = t + done;
        if (rate(s, now, x, k) || advance(s, now, left, x, k, y) || signs_at(s, now + left, y, after)) return 1;
        if (differ(m, after)) {
            if (depart(m, before, after)) {
                if (rate(s, now, x, k) || advance(s, now, left, x, k, y) || signs_at(s, now + left, y, after)) return 1;
            }
            if (crossing < MAX_CROSSINGS && any_crossed(m, after, before)
                && locate(s, now, &left, x, k, y, other, before, after, trial))
                return 1;
            hold(m, after);
        }
        memcpy(x, y, n * sizeof(double));
        memcpy(before, after, n_s * sizeof(double));
        done += left;
    }
    return 0;
}

int integrate(instance *m, const double *u, double begin, double end)
{
    double span = end - m->s.time;
    if (model.n_x == 0 || span <= 0.0) {
        m->s.time = end;
        return 0;
    }
    double whole = ceil(span / model.internal_step - 1e-6), t0 = m->s.time;
    long long steps = whole < 1.0 ? 1 : (long long)whole;
    double h = span / (double)steps, *x = m->values + AT_X, *k = m->scratch + AT_STAGES;
    double *before = m->scratch + AT_SWITCHES;
    solver s;
    s.m = m;
    s.u = u;
    s.begin = begin;
    arguments_of(m, &s.t, x, s.arg);
    if (model.n_switches) {
        if (signs_at(&s, t0, x, before)) return 1;
        hold(m, before);
    }
    for (long long i = 0; i < steps; i++) {
        double t = t0 + (double)i * h;
        if (model.n_switches) {
            if (sub_step(&s, t, h, x, k, before)) return 1;
        } else {
            double *y = k + 4 * model.n_x;
            if (rate(&s, t, x, k) || advance(&s, t, h, x, k, y)) return 1;
            memcpy(x, y, model.n_x * sizeof(double));
        }
    }
    m->s.time = end;
    return 0;
}
