/* Directional derivatives of outputs and state derivatives by inputs and states. */
#include <string.h>

#include "instance.h"

static int lookups_forward(instance *m, const casadi_real **arg, int purposes)
{
    double *arguments = m->scratch, *direction = arguments + model.n_arguments;
    double *results = m->values + AT_W, *dw = (double *)arg[DW], *gradient = m->scratch + AT_DIRECTION;
    char message[256];
    for (int i = 0; i < model.n_lookups; i++) {
        const lookup *l = &model.lookups[i];
        if (!(l->uses & purposes)) { /* its results are not those of the present states */
            dw += l->results;
            results += l->results;
            continue;
        }
        call(m, &l->argument, arg, arguments, NULL);
        call(m, &l->argument_forward, arg, direction, NULL);
        if (l->kind == STORED || l->kind == SWITCH) { /* a switch's is zero */
            memcpy(dw, direction, l->results * sizeof(double));
        } else if (l->kind == TABLE) {
            table_forward(l->data, arguments, direction, dw);
        } else if (l->kind == FIELD) {
            const field_data *d = l->data;
            memset(dw, 0, l->results * sizeof(double));
            if (m->boxes[d->string]) {
                if (wind_box_sample(m->boxes[d->string], arguments[0], arguments + 1, d->points, results, gradient,
                                    message, sizeof message))
                    return 1;
                for (int k = 0; k < 3 * d->points; k++)
                    for (int a = 0; a < 3; a++) dw[k] += gradient[4 * k + 1 + a] * direction[1 + 3 * (k / 3) + a];
            }
        } else if (implicit_forward(l->data, arguments, results, direction, dw, m->iwork, m->work)) {
            return 1;
        }
        dw += l->results;
        results += l->results;
    }
    return 0;
}

int directional_begin(instance *m, const char *function)
{
    if (m->s.mode == INSTANTIATED) return report(m, "%s: called before initialisation", function);
    if (!model.forward.evaluate) return report(m, "%s: not provided by this FMU", function);
    memset(m->scratch + AT_SEEDS, 0, ((size_t)model.n_x + model.n_u) * sizeof(double));
    return 0;
}

int directional_seed(instance *m, const char *function, int i, double value)
{
    double *dx = m->scratch + AT_SEEDS, *du = dx + model.n_x;
    if (i >= AT_U && i < AT_Y) du[i - AT_U] = value;
    else if (i >= AT_X && i < AT_Z) dx[i - AT_X] = value;
    else return report(m, "%s: %s is no input or state", function, model.variables[i].name);
    return 0;
}

/* Outputs need the lookups of outputs, rates those of rates. */
int directional_evaluate(instance *m, const char *function, int purposes)
{
    double *dx = m->scratch + AT_SEEDS, *du = dx + model.n_x, *dw = du + model.n_u, *rates = dw + model.n_w;
    if (refresh(m, purposes)) return 1;
    memset(dw, 0, model.n_w * sizeof(double));
    const casadi_real *arg[N_ARGUMENTS] = {0};
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    arg[DX] = dx;
    arg[DU] = du;
    arg[DW] = dw;
    if (lookups_forward(m, arg, purposes)) return report(m, "%s: a lookup failed", function);
    call(m, &model.forward, arg, rates, rates + model.n_x);
    return 0;
}

int directional_result(instance *m, const char *function, int i, double *value)
{
    const double *rates = m->scratch + AT_SEEDS + model.n_x + model.n_u + model.n_w, *outputs = rates + model.n_x;
    if (i >= AT_Y && i < AT_X) *value = outputs[i - AT_Y];
    else if (i >= AT_RATES && i < AT_INDICATORS) *value = rates[i - AT_RATES];
    else return report(m, "%s: %s is no output and no state derivative", function, model.variables[i].name);
    return 0;
}
