/* FMI 2.0 Co-Simulation on top of the generated equations: the course of a simulation, and its steps.
 *
 * No global state, any number of instances. Inputs are polynomials over the step (fmi2SetRealInputDerivatives, order 1
 * and 2); sampled states change at start + k * sample_time, k = 1, 2, ... (or 0, 1, ...).
 */
#include <float.h>
#include <math.h>
#include <string.h>

#include "instance.h"

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)n;
    (void)categories;
    if (!c) return fmi2Error;
    ((instance *)c)->logging = on;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance;
    (void)tolerance;
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode != INSTANTIATED || !isfinite(begin))
        return report(m, fmi2Error, "fmi2SetupExperiment: only once, before initialisation, with a finite start time");
    m->s.time = m->s.start = begin;
    m->s.stop = has_stop ? stop : HUGE_VAL;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode != INSTANTIATED) return report(m, fmi2Error, "fmi2EnterInitializationMode: called out of order");
    m->s.mode = INITIALISING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode != INITIALISING) return report(m, fmi2Error, "fmi2ExitInitializationMode: called out of order");
    if (!m->s.started) start(m);
    if (open_boxes(m) != fmi2OK) return fmi2Error;
    if (model.sample_at_start && current(m) != fmi2OK) return fmi2Error;
    m->s.mode = STEPPING;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode == STEPPING) m->s.mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    instance *m = c;
    if (!m) return fmi2Error;
    return restart(m) ? report(m, fmi2Error, "out of memory") : fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_rollback)
{
    (void)no_rollback;
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode != STEPPING) return report(m, fmi2Error, "fmi2DoStep: the FMU is not initialised, has ended or has failed");
    if (!(step > 0.0) || !isfinite(step)) return report(m, fmi2Error, "fmi2DoStep: step %g s is not positive", step);
    double slack = 1e-9 * fmax(1.0, fabs(now)) + 1e-6 * step;
    if (!isfinite(now) || fabs(now - m->s.time) > slack)
        return report(m, fmi2Error, "fmi2DoStep: called for %.9g s, but the FMU is at %.9g s", now, m->s.time);
    if (now + step > m->s.stop + slack)
        return report(m, fmi2Error, "fmi2DoStep: to %.9g s, beyond the stop time %.9g s", now + step, m->s.stop);
    double begin = now, end = now + step, *v = m->values;
    double *u = m->scratch + AT_STEP_U;
    memcpy(u, v + AT_U, model.n_u * sizeof(double));
    m->s.time = now;
    m->outputs_current = 0;
    while (model.sample_time > 0.0) {
        /* An importer that adds up its steps is off by about 1e-5 of one after a million: such an end is the instant. */
        double instant = m->s.start + (double)(m->s.samples + 1) * model.sample_time, near = 1e-4 * model.sample_time;
        if (instant > end + near) break;
        if (integrate(m, u, begin, instant > end - near ? end : instant) || sample(m, u, begin)) return fmi2Error;
        m->s.samples++;
    }
    if (integrate(m, u, begin, end)) return fmi2Error;
    inputs_at(m, u, end - begin);
    memset(v + AT_SLOPE, 0, 2 * (size_t)model.n_u * sizeof(double));
    int wrong = 0;
    for (int i = AT_X; i < AT_W; i++) wrong |= !(fabs(v[i]) <= DBL_MAX); /* without a branch: there may be thousands */
    for (int i = AT_X; wrong && i < AT_W; i++)
        if (!isfinite(v[i]))
            return report(m, fmi2Error, "state %s = %g at %g s: the model is unstable or the step too large",
                          model.variables[i].name, v[i], end);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return c ? report(c, fmi2Error, "fmi2CancelStep: steps are synchronous") : fmi2Error; }

static fmi2Status no_status(fmi2Component c) { return c ? fmi2Discard : fmi2Error; }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (!c || kind != fmi2LastSuccessfulTime || !value) return no_status(c);
    *value = ((instance *)c)->s.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (!c || kind != fmi2Terminated || !value) return no_status(c);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    return no_status(c);
}
