/* The course of a simulation: initialisation, steps of co-simulation, events of model exchange.
 *
 * Inputs are polynomials over a step (set_slope, orders 1 and 2), or what the importer says when asked; sampled states
 * change at start + k * sample_time, k = 1, 2, ... (or 0, 1, ...). */
#include <float.h>

#include "instance.h"

#define DEPARTURE 1e-6 /* of the internal step: how far ahead a switch at zero looks */

int set_up(instance *m, const char *function, double begin, int has_stop, double stop)
{
    if (m->s.mode != INSTANTIATED || !isfinite(begin))
        return report(m, "%s: only once, before initialisation, with a finite start time", function);
    m->s.time = m->s.start = begin;
    m->s.stop = has_stop ? stop : HUGE_VAL;
    return 0;
}

int begin_initialisation(instance *m, const char *function)
{
    if (m->s.mode != INSTANTIATED) return report(m, "%s: called out of order", function);
    m->s.mode = INITIALISING;
    return 0;
}

int end_initialisation(instance *m, const char *function)
{
    if (m->s.mode != INITIALISING) return report(m, "%s: called out of order", function);
    if (!m->s.started) start(m);
    if (open_boxes(m)) return 1;
    if (model.sample_at_start && refresh(m, FOR_OUTPUTS)) return 1;
    m->s.mode = m->model_exchange ? EVENT : STEPPING;
    return 0;
}

void terminate(instance *m)
{
    if (m->s.mode >= STEPPING && m->s.mode <= CONTINUOUS) m->s.mode = TERMINATED;
}

/* An importer that adds up its steps is off by about 1e-5 of one after a million: such a time is the instant. */
static double slack_of_instants(void) { return 1e-4 * model.sample_time; }

static double next_instant(const instance *m) { return m->s.start + (double)(m->s.samples + 1) * model.sample_time; }

int step(instance *m, const char *function, double now, double length)
{
    if (m->s.mode != STEPPING) return report(m, "%s: the FMU is not initialised, has ended or has failed", function);
    if (!(length > 0.0) || !isfinite(length)) return report(m, "%s: step %g s is not positive", function, length);
    double slack = 1e-9 * fmax(1.0, fabs(now)) + 1e-6 * length;
    if (!isfinite(now) || fabs(now - m->s.time) > slack)
        return report(m, "%s: called for %.9g s, but the FMU is at %.9g s", function, now, m->s.time);
    if (now + length > m->s.stop + slack)
        return report(m, "%s: to %.9g s, beyond the stop time %.9g s", function, now + length, m->s.stop);
    double begin = now, end = now + length, *v = m->values, *u = m->scratch + AT_STEP_U;
    memcpy(u, v + AT_U, model.n_u * sizeof(double));
    m->s.time = now;
    m->current = 0;
    while (model.sample_time > 0.0) {
        double instant = next_instant(m), near = slack_of_instants();
        if (instant > end + near) break;
        if (integrate(m, u, begin, instant > end - near ? end : instant) || sample(m, u, begin)) return 1;
        m->s.samples++;
    }
    if (integrate(m, u, begin, end)) return 1;
    inputs_at(m, u, begin, end);
    memset(v + AT_SLOPE, 0, 2 * (size_t)model.n_u * sizeof(double));
    if (m->s.mode == FAILED) return 1; /* as the importer set inputs on the way */
    int wrong = 0;
    /* without a branch: there may be thousands */
    for (int i = AT_X; i < AT_TIME; i++) wrong |= !(fabs(v[i]) <= DBL_MAX);
    for (int i = AT_X; wrong && i < AT_TIME; i++)
        if (!isfinite(v[i]))
            return report(m, "state %s = %g at %g s: the model is unstable or the step too large",
                          model.variables[i].name, v[i], end);
    return 0;
}

int exchanged(instance *m, const char *function, mode first, mode last)
{
    if (m->model_exchange && m->s.mode >= first && m->s.mode <= last) return 0;
    const char *reason = m->model_exchange ? "called out of order" : "this is a co-simulation instance";
    return report(m, "%s: %s", function, reason);
}

int enter_event_mode(instance *m, const char *function)
{
    if (exchanged(m, function, CONTINUOUS, CONTINUOUS)) return 1;
    m->s.mode = EVENT;
    m->current = 0;
    return 0;
}

int update_discrete(instance *m, const char *function, int *has_next, double *next)
{
    if (exchanged(m, function, EVENT, EVENT)) return 1;
    *has_next = model.sample_time > 0.0;
    if (!*has_next) return 0;
    while (next_instant(m) <= m->s.time + slack_of_instants()) {
        if (sample(m, m->values + AT_U, m->s.time)) return 1;
        m->s.samples++;
        m->current = 0;
    }
    *next = next_instant(m);
    return 0;
}

/* A root finder may stop where an indicator is exactly zero: such a switch takes the sign of what follows. */
static int depart_from_zero(instance *m)
{
    double *x = m->values + AT_X, *rates = m->values + AT_RATES, *now = m->values + AT_INDICATORS;
    double *before = m->scratch + AT_SWITCHES, *kept = m->scratch + AT_STAGES, time = m->s.time;
    int any = 0, failed;
    for (int i = 0; i < model.n_switches; i++) any |= now[i] == 0.0;
    if (!any) return 0;
    if (refresh(m, FOR_RATES)) return 1;
    memcpy(before, now, model.n_switches * sizeof(double));
    memcpy(kept, x, model.n_x * sizeof(double));
    for (int i = 0; i < model.n_x; i++) x[i] += DEPARTURE * model.internal_step * rates[i];
    m->s.time += DEPARTURE * model.internal_step;
    m->current = 0;
    failed = refresh(m, FOR_SIGNS);
    depart(m, before, now);
    memcpy(x, kept, model.n_x * sizeof(double));
    m->s.time = time;
    m->current = 0;
    return failed;
}

int enter_continuous_mode(instance *m, const char *function)
{
    if (exchanged(m, function, EVENT, EVENT) || refresh(m, FOR_SIGNS)) return 1;
    hold(m, m->values + AT_INDICATORS);
    m->s.mode = CONTINUOUS;
    m->current = 0;
    return depart_from_zero(m);
}

/* A switch that left zero, or changed unseen by the importer's root finder, is an event too. */
int complete_step(instance *m, const char *function, int *event)
{
    if (exchanged(m, function, CONTINUOUS, CONTINUOUS) || refresh(m, FOR_SIGNS)) return 1;
    *event = differ(m, m->values + AT_INDICATORS);
    return 0;
}

int set_time(instance *m, const char *function, double time)
{
    if (exchanged(m, function, EVENT, CONTINUOUS)) return 1;
    if (!isfinite(time)) return report(m, "%s: %g s is no time", function, time);
    if (m->s.time != time) m->current = 0;
    m->s.time = time;
    return 0;
}

static int fits(instance *m, const char *function, const void *values, size_t n, int expected)
{
    if (!values && expected) return report(m, "%s: null pointer", function), 0;
    if (n != (size_t)expected) return report(m, "%s: %u values, but there are %d", function, (unsigned)n, expected), 0;
    return 1;
}

int set_states(instance *m, const char *function, const double *x, size_t n)
{
    if (exchanged(m, function, CONTINUOUS, CONTINUOUS) || !fits(m, function, x, n, model.n_x)) return 1;
    for (int i = 0; i < model.n_x; i++) {
        if (!isfinite(x[i]))
            return report(m, "%s: %s = %g is not finite", function, model.variables[AT_X + i].name, x[i]);
        if (m->values[AT_X + i] != x[i]) m->current = 0;
        m->values[AT_X + i] = x[i];
    }
    return 0;
}

int get_states(instance *m, const char *function, double *x, size_t n)
{
    if (exchanged(m, function, INITIALISING, TERMINATED) || !fits(m, function, x, n, model.n_x) || begun(m)) return 1;
    if (n) memcpy(x, m->values + AT_X, n * sizeof(double));
    return 0;
}

int get_nominals(instance *m, const char *function, double *nominals, size_t n)
{
    if (exchanged(m, function, INITIALISING, TERMINATED) || !fits(m, function, nominals, n, model.n_x)) return 1;
    for (size_t i = 0; i < n; i++) nominals[i] = model.variables[(size_t)AT_X + i].nominal;
    return 0;
}

static int get_fresh(instance *m, const char *function, double *values, size_t n, int first, int expected, int purpose)
{
    if (exchanged(m, function, INITIALISING, TERMINATED) || !fits(m, function, values, n, expected)) return 1;
    if (refresh(m, purpose)) return 1;
    if (n) memcpy(values, m->values + first, n * sizeof(double));
    return 0;
}

int get_rates(instance *m, const char *function, double *rates, size_t n)
{
    return get_fresh(m, function, rates, n, AT_RATES, model.n_x, FOR_RATES);
}

int get_indicators(instance *m, const char *function, double *indicators, size_t n)
{
    return get_fresh(m, function, indicators, n, AT_INDICATORS, model.n_switches, FOR_SIGNS);
}
