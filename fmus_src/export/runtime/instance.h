/* One FMU instance: its data, and what the runtime's files offer each other. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <string.h>

#include "fmi2Functions.h"
#include "runtime.h"

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED, FAILED } mode;

/* All that changes between fmi2Instantiate and fmi2FreeInstance, in one block of doubles, a few scalars and the string
 * variables: the FMU state is a copy of exactly this. */
typedef struct {
    double time, start, stop; /* stop: HUGE_VAL if none was given */
    long long samples; /* sample instants passed */
    mode mode;
    int started;   /* initial states evaluated */
    int warm;      /* lookup results hold a last solution */
} scalars;

typedef struct {
    scalars s;
    double *values;       /* p, k, u, y, x, z, then w (lookup results), then slopes of u (orders 1 and 2) */
    char **strings;
    wind_box **boxes;     /* one per string variable */
    int outputs_current;
    double *scratch;      /* Runge-Kutta stages, lookup arguments, seeds */
    double *work;
    casadi_int *iwork;
    char *name;
    fmi2CallbackFunctions callbacks; /* a copy: the importer need not keep its own */
    int logging;
} instance;

#define AT_K (model.n_p)
#define AT_U (AT_K + model.n_k)
#define AT_Y (AT_U + model.n_u)
#define AT_X (AT_Y + model.n_y)
#define AT_Z (AT_X + model.n_x)
#define AT_W (AT_Z + model.n_z)
#define AT_SLOPE (AT_W + model.n_w)
#define AT_CURVE (AT_SLOPE + model.n_u)
#define N_VALUES (AT_CURVE + model.n_u)

/* In scratch; the lookups' arguments and their directions lead. */
#define AT_STAGES (2 * (size_t)model.n_arguments)
#define AT_NEXT_Z (AT_STAGES + 6 * (size_t)model.n_x) /* beyond four stages and two states */
#define AT_STEP_U (AT_NEXT_Z + model.n_z)
#define AT_SWITCHES (AT_STEP_U + model.n_u)
#define AT_DIRECTION AT_STAGES /* of a directional derivative, which needs none of the above */
#define N_STEPPING (AT_SWITCHES + 4 * (size_t)model.n_switches)
#define N_DIRECTION (AT_DIRECTION + 2 * (size_t)model.n_x + model.n_u + 13 * (size_t)model.n_w + model.n_y)

/* instance.c */
fmi2Status report(instance *m, fmi2Status status, const char *format, ...); /* logs, returns the status */
void *allocate(const fmi2CallbackFunctions *c, size_t count, size_t size);
void release(const fmi2CallbackFunctions *c, void *memory);
int set_text(instance *m, size_t i, const char *text);
int restart(instance *m);

/* evaluation.c: results of type int are 0, or 1 after a reported error */
int look_up(instance *m, const casadi_real **arg, int purpose); /* all of them, the first time, but switches for rates and signs */
void inputs_at(instance *m, const double *u, double after); /* u: at the step's begin; after: seconds since */
int sample(instance *m, const double *u, double begin);
void start(instance *m);
fmi2Status open_boxes(instance *m);
fmi2Status current(instance *m); /* brings the outputs up to date */

/* integration.c */
int integrate(instance *m, const double *u, double begin, double end);

/* variables.c */
fmi2Status unknown(instance *m, const char *function, fmi2ValueReference vr, const void *value); /* reports */

static inline fmi2Status check(instance *m, const char *function, fmi2ValueReference vr, variable_kind kind, const void *value)
{
    const int fine = value && vr < (fmi2ValueReference)model.n_variables && model.variables[vr].kind == kind;
    return fine ? fmi2OK : unknown(m, function, vr, value);
}

static inline void arguments_of(const instance *m, const double *t, const double *x, const casadi_real **arg)
{
    const double *v = m->values;
    arg[T] = t;
    arg[X] = x;
    arg[Z] = v + AT_Z;
    arg[U] = v + AT_U;
    arg[P] = v;
    arg[K] = v + AT_K;
    arg[W] = v + AT_W;
}

static inline void call(instance *m, const equation *e, const casadi_real **arg, double *first, double *second)
{
    const casadi_real *a[MAX_ARGUMENTS]; /* beyond what is set here: room for what CasADi passes inside */
    casadi_real *r[MAX_ARGUMENTS];
    memcpy(a, arg, N_ARGUMENTS * sizeof *arg);
    r[0] = first;
    r[1] = second;
    e->evaluate(a, r, m->iwork, m->work, 0);
}

#endif
