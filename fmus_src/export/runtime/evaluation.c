/* Evaluation of the generated equations at the instance's present time, states and inputs. */
#include <math.h>
#include <string.h>

#include "instance.h"

int look_up(instance *m, const casadi_real **arg, int purpose)
{
    double *arguments = m->scratch, *result = m->values + AT_W;
    char message[512];
    for (int i = 0; i < model.n_lookups; i++) {
        const lookup *l = &model.lookups[i];
        if (l->kind == SWITCH ? !(purpose & WITH_SWITCHES) : m->s.warm && !(l->uses & purpose)) { /* stays as it is */
            result += l->results;
            continue;
        }
        call(m, &l->argument, arg, l->kind == STORED ? result : arguments, NULL);
        if (l->kind == STORED) {
        } else if (l->kind == SWITCH) {
            for (int k = 0; k < l->results; k++) result[k] = arguments[k] > 0.0;
        } else if (l->kind == TABLE) {
            table_evaluate(l->data, arguments, result);
        } else if (l->kind == FIELD) {
            const field_data *d = l->data;
            const wind_box *box = m->boxes[d->string];
            if (!box) {
                memset(result, 0, l->results * sizeof(double));
            } else {
                result[l->results - 1] = 1.0;
                if (wind_box_sample(box, arguments[0], arguments + 1, d->points, result, NULL, message,
                                    sizeof message)) {
                    report(m, "%s at %g s: %s", model.string_names[d->string], arguments[0], message);
                    return 1;
                }
            }
        } else if (implicit_evaluate(l->data, arguments, m->s.warm, result, m->iwork, m->work, message,
                                     sizeof message)) {
            report(m, "at %g s: %s", *arg[T], message);
            return 1;
        }
        result += l->results;
    }
    m->s.warm = 1;
    return 0;
}

void inputs_at(instance *m, const double *u, double begin, double time)
{
    double *v = m->values, after = time - begin;
    if (m->ask) {
        m->ask(m, time);
        return;
    }
    for (int i = 0; i < model.n_u; i++)
        v[AT_U + i] = u[i] + after * (v[AT_SLOPE + i] + 0.5 * after * v[AT_CURVE + i]);
}

int sample(instance *m, const double *u, double begin)
{
    const casadi_real *arg[N_ARGUMENTS] = {0};
    double *next = m->scratch + AT_NEXT_Z;
    inputs_at(m, u, begin, m->s.time);
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    if (look_up(m, arg, FOR_UPDATE | WITH_SWITCHES)) return 1;
    call(m, &model.update, arg, next, NULL);
    memcpy(m->values + AT_Z, next, model.n_z * sizeof(double));
    return 0;
}

/* Calculated parameters and initial states: at the first need in initialisation mode, and again after a change. */
void start(instance *m)
{
    const casadi_real *arg[N_ARGUMENTS] = {m->values};
    double *v = m->values;
    call(m, &model.calculate, arg, v + AT_K, NULL);
    arg[1] = v + AT_K;
    call(m, &model.initial, arg, v + AT_X, v + AT_Z);
    m->s.started = 1;
    m->s.warm = 0;
    m->current = 0;
}

int open_boxes(instance *m)
{
    char message[512];
    for (int i = 0; i < model.n_lookups; i++) {
        if (model.lookups[i].kind != FIELD) continue;
        int s = ((const field_data *)model.lookups[i].data)->string;
        if (m->boxes[s] || !m->strings[s][0]) continue;
        m->boxes[s] = wind_box_open(m->resources, m->strings[s], message, sizeof message);
        if (!m->boxes[s]) return report(m, "%s: %s", model.string_names[s], message);
    }
    return 0;
}

int begun(instance *m)
{
    if (m->s.started || m->s.mode == INSTANTIATED) return 0;
    start(m);
    return open_boxes(m);
}

static int all_finite(instance *m, const char *what, int first, int n)
{
    const double *v = m->values + first;
    for (int i = 0; i < n; i++)
        if (!isfinite(v[i]))
            return report(m, "%s %s = %g at %g s is not finite", what, model.variables[first + i].name, v[i],
                          m->s.time), 0;
    return 1;
}

int refresh(instance *m, int purposes)
{
    const casadi_real *arg[N_ARGUMENTS] = {0};
    if (!(purposes & ~m->current) || m->s.mode == INSTANTIATED) return 0;
    if (begun(m)) return 1;
    if (m->s.mode == INITIALISING && model.sample_at_start) { /* anew with every change of an input */
        start(m);
        if (sample(m, m->values + AT_U, m->s.time)) return 1;
    }
    const int missing = purposes & ~m->current;
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    /* Between events of model exchange the switches are held, so that its integrator sees smooth equations. */
    if (look_up(m, arg, m->s.mode == CONTINUOUS ? missing : missing | WITH_SWITCHES)) return 1;
    if (missing & FOR_OUTPUTS) {
        call(m, &model.outputs, arg, m->values + AT_Y, NULL);
        if (!all_finite(m, "output", AT_Y, model.n_y)) return 1;
    }
    if (missing & FOR_RATES) {
        call(m, &model.derivatives, arg, m->values + AT_RATES, NULL);
        if (!all_finite(m, "derivative", AT_RATES, model.n_x)) return 1;
    }
    if (missing & FOR_SIGNS) call(m, &model.switches, arg, m->values + AT_INDICATORS, NULL);
    m->current |= missing;
    return 0;
}
