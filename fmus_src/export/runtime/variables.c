/* Getting and setting variables, and time derivatives of inputs. */
#include <float.h>
#include <math.h>

#include "instance.h"

fmi2Status unknown(instance *m, const char *function, fmi2ValueReference vr, const void *value)
{
    if (!value) return report(m, fmi2Error, "%s: null pointer", function);
    return report(m, fmi2Error, "%s: no such value reference: %u", function, (unsigned)vr);
}

static fmi2Status get(instance *m, const char *function, const fmi2ValueReference *vr, size_t n, variable_kind kind,
                      double *reals, int *integers)
{
    if (!m) return fmi2Error;
    int up_to_date = 0;
    for (size_t i = 0; i < n; i++) {
        if (check(m, function, vr[i], kind, reals ? (void *)reals : (void *)integers) != fmi2OK) return fmi2Error;
        if (!up_to_date && model.variables[vr[i]].role >= CALCULATED) {
            if (current(m) != fmi2OK) return fmi2Error;
            up_to_date = 1;
        }
        if (reals) reals[i] = m->values[vr[i]];
        else integers[i] = (int)m->values[vr[i]];
    }
    return fmi2OK;
}

static fmi2Status set_one(instance *m, const char *function, fmi2ValueReference vr, double value)
{
    const variable *v = &model.variables[vr];
    if (!isfinite(value)) return report(m, fmi2Error, "%s: %s = %g is not finite (at %g s)", function, v->name, value, m->s.time);
    if (value < v->min || value > v->max)
        return report(m, fmi2Error, "%s: %s = %g is outside its bounds %g to %g", function, v->name, value, v->min, v->max);
    const char *obstacle = NULL;
    if (v->role != INPUT && v->role != TUNABLE_PARAMETER && v->role != FIXED_PARAMETER) obstacle = ": it is computed by the FMU";
    else if (m->s.mode > STEPPING) obstacle = " after fmi2Terminate or an error";
    else if (v->role == FIXED_PARAMETER && m->s.mode == STEPPING) obstacle = " after initialisation";
    if (obstacle) return report(m, fmi2Error, "%s: %s cannot be set%s", function, v->name, obstacle);
    if (m->values[vr] == value) return fmi2OK;
    m->values[vr] = value;
    m->outputs_current = 0;
    if (m->s.mode != STEPPING) m->s.started = 0; /* initial states follow the parameters */
    else {
        const casadi_real *arg[N_ARGUMENTS] = {m->values};
        call(m, &model.calculate, arg, m->values + AT_K, NULL);
    }
    return fmi2OK;
}

static fmi2Status set(instance *m, const char *function, const fmi2ValueReference *vr, size_t n, variable_kind kind,
                      const double *reals, const int *integers)
{
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(m, function, vr[i], kind, reals ? (const void *)reals : (const void *)integers) != fmi2OK) return fmi2Error;
        double value = reals ? reals[i] : kind == BOOLEAN ? integers[i] != 0 : integers[i];
        const variable *v = &model.variables[vr[i]];
        if (v->role == INPUT && m->s.mode <= STEPPING && fabs(value) <= DBL_MAX && value >= v->min && value <= v->max) {
            if (m->values[vr[i]] != value) m->outputs_current = 0;
            m->values[vr[i]] = value;
            continue;
        }
        if (set_one(m, function, vr[i], value) != fmi2OK) return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    return get(c, "fmi2GetReal", vr, n, REAL, value, NULL);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    return get(c, "fmi2GetInteger", vr, n, INTEGER, NULL, value);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    return get(c, "fmi2GetBoolean", vr, n, BOOLEAN, NULL, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    instance *m = c;
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= (fmi2ValueReference)model.n_strings || !value)
            return report(m, fmi2Error, "fmi2GetString: no such value reference: %u", (unsigned)vr[i]);
        value[i] = m->strings[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    return set(c, "fmi2SetReal", vr, n, REAL, value, NULL);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    return set(c, "fmi2SetInteger", vr, n, INTEGER, NULL, value);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    return set(c, "fmi2SetBoolean", vr, n, BOOLEAN, NULL, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    instance *m = c;
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= (fmi2ValueReference)model.n_strings || !value || !value[i])
            return report(m, fmi2Error, "fmi2SetString: no such value reference: %u", (unsigned)vr[i]);
        if (m->s.mode >= STEPPING)
            return report(m, fmi2Error, "fmi2SetString: %s cannot be set after initialisation", model.string_names[vr[i]]);
        if (set_text(m, vr[i], value[i])) return report(m, fmi2Error, "out of memory");
        m->s.started = 0;
        m->outputs_current = 0;
    }
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    instance *m = c;
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(m, "fmi2SetRealInputDerivatives", vr[i], REAL, order && value ? value : NULL) != fmi2OK) return fmi2Error;
        if (model.variables[vr[i]].role != INPUT || order[i] < 1 || order[i] > 2 || !isfinite(value[i]))
            return report(m, fmi2Error, "fmi2SetRealInputDerivatives: %s: needs an input, order 1 or 2, a finite value",
                          model.variables[vr[i]].name);
        m->values[(order[i] == 1 ? AT_SLOPE : AT_CURVE) + (int)vr[i] - AT_U] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[])
{
    (void)vr;
    (void)n;
    (void)order;
    (void)value;
    return c ? report(c, fmi2Error, "fmi2GetRealOutputDerivatives: not provided (maxOutputDerivativeOrder is 0)") : fmi2Error;
}
