/* Setting variables, and time derivatives of inputs. */
#include "instance.h"

int unknown(instance *m, const char *function, unsigned vr, const void *value)
{
    if (!value) return report(m, "%s: null pointer", function);
    return report(m, "%s: no such value reference: %u", function, vr);
}

int set_value(instance *m, const char *function, int i, double value)
{
    const variable *v = &model.variables[i];
    if (!isfinite(value)) return report(m, "%s: %s = %g is not finite (at %g s)", function, v->name, value, m->s.time);
    if (value < v->min || value > v->max)
        return report(m, "%s: %s = %g is outside its bounds %g to %g", function, v->name, value, v->min, v->max);
    const char *obstacle = NULL;
    if (v->role > INPUT) obstacle = ": it is computed by the FMU";
    else if (m->s.mode > CONTINUOUS) obstacle = " after its end or an error";
    else if (v->role == FIXED_PARAMETER && m->s.mode >= STEPPING) obstacle = " after initialisation";
    else if (v->role == TUNABLE_PARAMETER && m->s.mode == CONTINUOUS) obstacle = " outside event mode";
    if (obstacle) return report(m, "%s: %s cannot be set%s", function, v->name, obstacle);
    if (m->values[i] == value) return 0;
    m->values[i] = value;
    m->current = 0;
    if (m->s.mode < STEPPING) m->s.started = 0; /* initial states follow the parameters */
    else {
        const casadi_real *arg[N_ARGUMENTS] = {m->values};
        call(m, &model.calculate, arg, m->values + AT_K, NULL);
    }
    return 0;
}

int set_string(instance *m, const char *function, size_t i, const char *text)
{
    if (!text) return report(m, "%s: null pointer", function);
    if (m->s.mode >= STEPPING)
        return report(m, "%s: %s cannot be set after initialisation", function, model.string_names[i]);
    if (set_text(m, i, text)) return report(m, "out of memory");
    m->s.started = 0;
    m->current = 0;
    return 0;
}

int set_slope(instance *m, const char *function, int i, int order, double value)
{
    const variable *v = &model.variables[i];
    if (v->role != INPUT || order < 1 || order > 2 || !isfinite(value))
        return report(m, "%s: %s: needs an input, order 1 or 2, a finite value", function, v->name);
    m->values[(order == 1 ? AT_SLOPE : AT_CURVE) + i - AT_U] = value;
    return 0;
}
