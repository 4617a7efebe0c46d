/* Directional derivatives of outputs by inputs and states. */
#include <string.h>

#include "instance.h"

static int lookups_forward(instance *m, const casadi_real **arg)
{
    double *arguments = m->scratch, *direction = arguments + model.n_arguments;
    double *results = m->values + AT_W, *dw = (double *)arg[DW], *gradient = m->scratch + AT_DIRECTION;
    char message[256];
    for (int i = 0; i < model.n_lookups; i++) {
        const lookup *l = &model.lookups[i];
        if (!(l->uses & FOR_OUTPUTS)) { /* its results are not those of the present states */
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
                if (wind_box_sample(m->boxes[d->string], arguments[0], arguments + 1, d->points, results, gradient, message, sizeof message))
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

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real dknown[],
                                        fmi2Real dunknown[])
{
    instance *m = c;
    if (!m) return fmi2Error;
    if (m->s.mode == INSTANTIATED) return report(m, fmi2Error, "fmi2GetDirectionalDerivative: called before initialisation");
    if (!model.forward.evaluate) return report(m, fmi2Error, "fmi2GetDirectionalDerivative: not provided by this FMU");
    if (current(m) != fmi2OK) return fmi2Error;
    double *dx = m->scratch + AT_DIRECTION + 12 * (size_t)model.n_w, *du = dx + model.n_x;
    double *dw = du + model.n_u, *rates = dw + model.n_w, *outputs = rates + model.n_x;
    memset(dx, 0, ((size_t)model.n_x + model.n_u + model.n_w) * sizeof(double));
    for (size_t i = 0; i < n_known; i++) {
        if (check(m, "fmi2GetDirectionalDerivative", known[i], REAL, dknown) != fmi2OK) return fmi2Error;
        int at = (int)known[i];
        if (at >= AT_U && at < AT_Y) du[at - AT_U] = dknown[i];
        else if (at >= AT_X && at < AT_Z) dx[at - AT_X] = dknown[i];
        else return report(m, fmi2Error, "fmi2GetDirectionalDerivative: %s is no input or state", model.variables[at].name);
    }
    const casadi_real *arg[N_ARGUMENTS] = {0};
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    arg[DX] = dx;
    arg[DU] = du;
    arg[DW] = dw;
    if (lookups_forward(m, arg)) return report(m, fmi2Error, "fmi2GetDirectionalDerivative: a lookup failed");
    call(m, &model.forward, arg, rates, outputs);
    for (size_t i = 0; i < n_unknown; i++) {
        if (check(m, "fmi2GetDirectionalDerivative", unknown[i], REAL, dunknown) != fmi2OK) return fmi2Error;
        int at = (int)unknown[i];
        if (at < AT_Y || at >= AT_X) return report(m, fmi2Error, "fmi2GetDirectionalDerivative: %s is no output", model.variables[at].name);
        dunknown[i] = outputs[at - AT_Y];
    }
    return fmi2OK;
}
