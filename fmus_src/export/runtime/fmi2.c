/* FMI 2.0 Co-Simulation on top of the generated equations: no global state, any number of instances.
 *
 * Integration: classical Runge-Kutta with sub-steps of at most `internal_step`; inputs are polynomials over the step
 * (fmi2SetRealInputDerivatives, order 1 and 2); sampled states change at start + k * sample_time, k = 1, 2, ... (or 0, 1, ...)
 */
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
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

typedef struct {
    size_t size;     /* of all, in bytes */
    scalars s;
    double values[]; /* then texts, each with its final zero: the guid and the string variables */
} saved_state;

/* --- layout ----------------------------------------------------------------------------------------------------- */

#define AT_K (model.n_p)
#define AT_U (AT_K + model.n_k)
#define AT_Y (AT_U + model.n_u)
#define AT_X (AT_Y + model.n_y)
#define AT_Z (AT_X + model.n_x)
#define AT_W (AT_Z + model.n_z)
#define AT_SLOPE (AT_W + model.n_w)
#define AT_CURVE (AT_SLOPE + model.n_u)
#define N_VALUES (AT_CURVE + model.n_u)
#define AT_TEXTS (sizeof(saved_state) + (size_t)N_VALUES * sizeof(double)) /* in the bytes of a saved state */

static const char *const CATEGORY_ERROR = "logStatusError";

static fmi2Status report(instance *m, fmi2Status status, const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    if (status >= fmi2Error) m->s.mode = FAILED;
    if (!m->callbacks.logger) return status;
    /* The text itself is the format, since many importers do not expand arguments; so percent signs are doubled. */
    char escaped[2 * sizeof text], *to = escaped;
    for (const char *from = text; *from; from++) {
        if (*from == '%') *to++ = '%';
        *to++ = *from;
    }
    *to = 0;
    m->callbacks.logger(m->callbacks.componentEnvironment, m->name, status, CATEGORY_ERROR, escaped);
    return status;
}

/* --- evaluation ------------------------------------------------------------------------------------------------- */

static void arguments_of(const instance *m, const double *t, const double *x, const casadi_real **arg)
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

static void call(instance *m, const equation *e, const casadi_real **arg, double *first, double *second)
{
    const casadi_real *a[MAX_ARGUMENTS]; /* beyond what is set here: room for what CasADi passes inside */
    casadi_real *r[MAX_ARGUMENTS];
    memcpy(a, arg, N_ARGUMENTS * sizeof *arg);
    r[0] = first;
    r[1] = second;
    e->evaluate(a, r, m->iwork, m->work, 0);
}

static int look_up(instance *m, const casadi_real **arg)
{
    double *arguments = m->scratch, *result = m->values + AT_W;
    char message[512];
    for (int i = 0; i < model.n_lookups; i++) {
        const lookup *l = &model.lookups[i];
        call(m, &l->argument, arg, l->kind == STORED ? result : arguments, NULL);
        if (l->kind == STORED) {
        } else if (l->kind == TABLE) {
            table_evaluate(l->data, arguments, result);
        } else if (l->kind == FIELD) {
            const field_data *d = l->data;
            const wind_box *box = m->boxes[d->string];
            if (!box) {
                memset(result, 0, l->results * sizeof(double));
            } else {
                result[l->results - 1] = 1.0;
                if (wind_box_sample(box, arguments[0], arguments + 1, d->points, result, NULL, message, sizeof message)) {
                    report(m, fmi2Error, "%s at %g s: %s", model.string_names[d->string], arguments[0], message);
                    return 1;
                }
            }
        } else if (implicit_evaluate(l->data, arguments, m->s.warm, result, m->iwork, m->work, message, sizeof message)) {
            report(m, fmi2Error, "at %g s: %s", *arg[T], message);
            return 1;
        }
        result += l->results;
    }
    m->s.warm = 1;
    return 0;
}

static void inputs_at(instance *m, const double *u, double after)
{
    double *v = m->values;
    for (int i = 0; i < model.n_u; i++)
        v[AT_U + i] = u[i] + after * (v[AT_SLOPE + i] + 0.5 * after * v[AT_CURVE + i]);
}

static int rate(instance *m, const double *u, double begin, double t, const double *x, double *dx)
{
    const casadi_real *arg[N_ARGUMENTS] = {0};
    inputs_at(m, u, t - begin);
    arguments_of(m, &t, x, arg);
    if (look_up(m, arg)) return 1;
    call(m, &model.derivatives, arg, dx, NULL);
    return 0;
}

static int integrate(instance *m, const double *u, double begin, double end)
{
    int n = model.n_x;
    double span = end - m->s.time;
    if (n == 0 || span <= 0.0) {
        m->s.time = end;
        return 0;
    }
    double whole = ceil(span / model.internal_step - 1e-6), t0 = m->s.time;
    long long steps = whole < 1.0 ? 1 : (long long)whole;
    double h = span / (double)steps, *x = m->values + AT_X;
    double *k1 = m->scratch + model.n_arguments, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *y = k4 + n;
    for (long long i = 0; i < steps; i++) {
        double t = t0 + (double)i * h;
        if (rate(m, u, begin, t, x, k1)) return 1;
        for (int j = 0; j < n; j++) y[j] = x[j] + 0.5 * h * k1[j];
        if (rate(m, u, begin, t + 0.5 * h, y, k2)) return 1;
        for (int j = 0; j < n; j++) y[j] = x[j] + 0.5 * h * k2[j];
        if (rate(m, u, begin, t + 0.5 * h, y, k3)) return 1;
        for (int j = 0; j < n; j++) y[j] = x[j] + h * k3[j];
        if (rate(m, u, begin, t + h, y, k4)) return 1;
        for (int j = 0; j < n; j++) x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
    }
    m->s.time = end;
    return 0;
}

static int sample(instance *m, const double *u, double begin)
{
    const casadi_real *arg[N_ARGUMENTS] = {0};
    double *next = m->scratch + model.n_arguments;
    inputs_at(m, u, m->s.time - begin);
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    if (look_up(m, arg)) return 1;
    call(m, &model.update, arg, next, NULL);
    memcpy(m->values + AT_Z, next, model.n_z * sizeof(double));
    return 0;
}

/* Calculated parameters and initial states: at the first need in initialisation mode, and again after a change. */
static void start(instance *m)
{
    const casadi_real *arg[N_ARGUMENTS] = {m->values};
    double *v = m->values;
    call(m, &model.calculate, arg, v + AT_K, NULL);
    arg[1] = v + AT_K;
    call(m, &model.initial, arg, v + AT_X, v + AT_Z);
    m->s.started = 1;
    m->s.warm = 0;
    m->outputs_current = 0;
}

static fmi2Status open_boxes(instance *m)
{
    char message[512];
    for (int i = 0; i < model.n_lookups; i++) {
        if (model.lookups[i].kind != FIELD) continue;
        int s = ((const field_data *)model.lookups[i].data)->string;
        if (m->boxes[s] || !m->strings[s][0]) continue;
        m->boxes[s] = wind_box_open(m->strings[s], message, sizeof message);
        if (!m->boxes[s]) return report(m, fmi2Error, "%s: %s", model.string_names[s], message);
    }
    return fmi2OK;
}

static fmi2Status current(instance *m)
{
    const casadi_real *arg[N_ARGUMENTS] = {0};
    double *y = m->values + AT_Y;
    if (m->outputs_current || m->s.mode == INSTANTIATED) return fmi2OK;
    if (!m->s.started) {
        start(m);
        if (open_boxes(m) != fmi2OK) return fmi2Error;
    }
    if (m->s.mode == INITIALISING && model.sample_at_start) { /* anew with every change of an input */
        start(m);
        if (sample(m, m->values + AT_U, m->s.time)) return fmi2Error;
    }
    arguments_of(m, &m->s.time, m->values + AT_X, arg);
    if (model.outputs_look_up && look_up(m, arg)) return fmi2Error;
    call(m, &model.outputs, arg, y, NULL);
    for (int i = 0; i < model.n_y; i++)
        if (!isfinite(y[i]))
            return report(m, fmi2Error, "output %s = %g at %g s is not finite", model.variables[AT_Y + i].name, y[i], m->s.time);
    m->outputs_current = 1;
    return fmi2OK;
}

/* --- creation --------------------------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

static void *allocate(const fmi2CallbackFunctions *c, size_t count, size_t size)
{
    if (count == 0) count = 1;
    return c && c->allocateMemory && c->freeMemory ? c->allocateMemory(count, size) : calloc(count, size);
}

static void release(const fmi2CallbackFunctions *c, void *memory)
{
    if (!memory) return;
    if (c && c->allocateMemory && c->freeMemory) c->freeMemory(memory);
    else free(memory);
}

static char *copy_text(const fmi2CallbackFunctions *c, const char *text)
{
    char *copy = allocate(c, strlen(text) + 1, 1);
    if (copy) strcpy(copy, text);
    return copy;
}

static void largest(casadi_int *iw, casadi_int *w, const equation *e)
{
    casadi_int sizes[4] = {0};
    if (!e->work) return;
    e->work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
    if (sizes[2] > *iw) *iw = sizes[2];
    if (sizes[3] > *w) *w = sizes[3];
}

static int allocate_work(instance *m)
{
    casadi_int iw = 1, w = 1;
    const equation *all[] = {&model.calculate, &model.initial, &model.derivatives, &model.outputs, &model.update, &model.forward};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) largest(&iw, &w, all[i]);
    for (int i = 0; i < model.n_lookups; i++) {
        largest(&iw, &w, &model.lookups[i].argument);
        largest(&iw, &w, &model.lookups[i].argument_forward);
        if (model.lookups[i].kind != IMPLICIT) continue;
        const implicit_data *d = model.lookups[i].data;
        largest(&iw, &w, &d->system);
        largest(&iw, &w, &d->guess);
    }
    size_t scratch = 2 * (size_t)model.n_arguments + 6 * (size_t)(model.n_x + model.n_z + model.n_u) + 13 * (size_t)model.n_w
                     + model.n_y;
    m->iwork = allocate(&m->callbacks, (size_t)iw, sizeof(casadi_int));
    m->work = allocate(&m->callbacks, (size_t)w, sizeof(double));
    m->scratch = allocate(&m->callbacks, scratch, sizeof(double));
    return !(m->iwork && m->work && m->scratch);
}

/* Give a string variable a value, whose wind box is opened at the next need; 1 if out of memory. */
static int set_text(instance *m, size_t i, const char *text)
{
    char *copy = copy_text(&m->callbacks, text);
    if (!copy) return 1;
    release(&m->callbacks, m->strings[i]);
    m->strings[i] = copy;
    wind_box_close(m->boxes[i]);
    m->boxes[i] = NULL;
    return 0;
}

static int restart(instance *m)
{
    memset(&m->s, 0, sizeof m->s);
    m->s.stop = HUGE_VAL;
    memset(m->values, 0, N_VALUES * sizeof(double));
    m->outputs_current = 0;
    for (int i = 0; i < model.n_variables; i++) m->values[i] = model.variables[i].start;
    for (int i = 0; i < model.n_strings; i++)
        if (set_text(m, (size_t)i, model.string_starts[i])) return 1;
    return 0;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources;
    (void)visible;
    instance *m = allocate(callbacks, 1, sizeof *m);
    if (!m) return NULL;
    if (callbacks) m->callbacks = *callbacks;
    m->logging = logging;
    m->name = copy_text(callbacks, name && name[0] ? name : model.identifier);
    m->values = allocate(callbacks, N_VALUES, sizeof(double));
    m->strings = allocate(callbacks, model.n_strings, sizeof(char *));
    m->boxes = allocate(callbacks, model.n_strings, sizeof(wind_box *));
    if (m->name && m->values && m->strings && m->boxes && !allocate_work(m) && !restart(m)) {
        if (type != fmi2CoSimulation) report(m, fmi2Error, "only co-simulation is provided");
        else if (!guid || strcmp(guid, model.guid)) report(m, fmi2Error, "the guid is not this FMU's (%s)", model.guid);
        else return m;
    }
    fmi2FreeInstance(m);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    instance *m = c;
    if (!m) return;
    const fmi2CallbackFunctions copy = m->callbacks, *callbacks = &copy;
    for (int i = 0; i < model.n_strings; i++) {
        if (m->boxes) wind_box_close(m->boxes[i]);
        if (m->strings) release(callbacks, m->strings[i]);
    }
    release(callbacks, m->boxes);
    release(callbacks, m->strings);
    release(callbacks, m->values);
    release(callbacks, m->scratch);
    release(callbacks, m->work);
    release(callbacks, m->iwork);
    release(callbacks, m->name);
    release(callbacks, m);
}

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

/* --- variables -------------------------------------------------------------------------------------------------- */

static fmi2Status check(instance *m, const char *function, fmi2ValueReference vr, variable_kind kind, const void *value)
{
    if (!value) return report(m, fmi2Error, "%s: null pointer", function);
    if (vr >= (fmi2ValueReference)model.n_variables || model.variables[vr].kind != kind)
        return report(m, fmi2Error, "%s: no such value reference: %u", function, (unsigned)vr);
    return fmi2OK;
}

static fmi2Status get(instance *m, const char *function, const fmi2ValueReference *vr, size_t n, variable_kind kind,
                      double *reals, int *integers)
{
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(m, function, vr[i], kind, reals ? (void *)reals : (void *)integers) != fmi2OK) return fmi2Error;
        if (model.variables[vr[i]].role >= CALCULATED && current(m) != fmi2OK) return fmi2Error;
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
    if (v->role == INPUT) return fmi2OK;
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

/* --- stepping --------------------------------------------------------------------------------------------------- */

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
    double *u = m->scratch + model.n_arguments + 5 * model.n_x + model.n_z; /* beyond the Runge-Kutta stages */
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

/* --- FMU state -------------------------------------------------------------------------------------------------- */

/* A state of this size: the one given if it fits, else a new one in its place. */
static saved_state *room_for_state(instance *m, fmi2FMUstate *state, size_t size)
{
    saved_state *saved = *state;
    if (saved && saved->size == size) return saved;
    release(&m->callbacks, saved);
    *state = saved = allocate(&m->callbacks, 1, size);
    if (saved) saved->size = size;
    return saved;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !state) return fmi2Error;
    size_t size = AT_TEXTS + strlen(model.guid) + 1;
    for (int i = 0; i < model.n_strings; i++) size += strlen(m->strings[i]) + 1;
    saved_state *saved = room_for_state(m, state, size);
    if (!saved) return report(m, fmi2Error, "out of memory");
    saved->s = m->s;
    memcpy(saved->values, m->values, N_VALUES * sizeof(double));
    char *text = (char *)saved + AT_TEXTS;
    strcpy(text, model.guid);
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        strcpy(text, m->strings[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    instance *m = c;
    const saved_state *saved = state;
    if (!m || !saved) return fmi2Error;
    const char *text = (const char *)saved + AT_TEXTS;
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        if (strcmp(text, m->strings[i]) && set_text(m, (size_t)i, text)) return report(m, fmi2Error, "out of memory");
    }
    m->s = saved->s;
    memcpy(m->values, saved->values, N_VALUES * sizeof(double));
    m->outputs_current = 0;
    /* A state from another instance or process: its wind files are not open here yet. */
    return m->s.started ? open_boxes(m) : fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !state) return fmi2Error;
    release(&m->callbacks, *state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    if (!c || !state || !size) return fmi2Error;
    *size = ((saved_state *)state)->size;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (!c || !state || !bytes) return fmi2Error;
    size_t needed = ((saved_state *)state)->size;
    if (size < needed) return report(c, fmi2Error, "fmi2SerializeFMUstate: needs %u bytes", (unsigned)needed);
    memcpy(bytes, state, needed);
    return fmi2OK;
}

static int is_state(const fmi2Byte *bytes, size_t size)
{
    size_t own, guid = strlen(model.guid) + 1;
    int texts = 0;
    if (size < AT_TEXTS + guid || memcmp(bytes + AT_TEXTS, model.guid, guid)) return 0;
    memcpy(&own, bytes, sizeof own);
    for (size_t i = AT_TEXTS; i < size; i++) texts += bytes[i] == 0;
    return own == size && texts == 1 + model.n_strings && bytes[size - 1] == 0;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !bytes || !state) return fmi2Error;
    if (!is_state(bytes, size)) return report(m, fmi2Error, "fmi2DeSerializeFMUstate: %u bytes are no state of this FMU", (unsigned)size);
    if (!room_for_state(m, state, size)) return report(m, fmi2Error, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

/* --- directional derivatives ------------------------------------------------------------------------------------ */

static int lookups_forward(instance *m, const casadi_real **arg)
{
    double *arguments = m->scratch, *direction = arguments + model.n_arguments;
    double *results = m->values + AT_W, *dw = (double *)arg[DW], *gradient = m->scratch + 2 * (size_t)model.n_arguments;
    char message[256];
    for (int i = 0; i < model.n_lookups; i++) {
        const lookup *l = &model.lookups[i];
        call(m, &l->argument, arg, arguments, NULL);
        call(m, &l->argument_forward, arg, direction, NULL);
        if (l->kind == STORED) {
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
    if (current(m) != fmi2OK) return fmi2Error;
    double *dx = m->scratch + 2 * (size_t)model.n_arguments + 12 * (size_t)model.n_w, *du = dx + model.n_x;
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
