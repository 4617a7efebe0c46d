/* An instance of FMI 3.0 behind FMI 2.0's functions, which are the kernel's: scalars by number in place of arrays.
 *
 * `values` has every element of the FMU as it was last set or read, arrays in one piece. FMI 2.0's slopes of inputs
 * become values within the step, which FMI 3.0 lets the FMU ask for (intermediate update).
 */
#include "adapter.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Types by their names in FMI 3.0, with the least and the largest value that a double may be to fit them. */
#define NUMERIC_TYPES(X)                                                                                              \
    X(Float64, -HUGE_VAL, HUGE_VAL) X(Float32, -FLT_MAX, FLT_MAX)   X(Int8, INT8_MIN, INT8_MAX)                        \
    X(UInt8, 0.0, UINT8_MAX) X(Int16, INT16_MIN, INT16_MAX) X(UInt16, 0.0, UINT16_MAX) X(Int32, INT32_MIN, INT32_MAX)  \
    X(UInt32, 0.0, UINT32_MAX) X(Int64, -9.2e18, 9.2e18) X(UInt64, 0.0, 1.8e19) X(Boolean, 0.0, 1.0)

#define NUMBER(NAME, LOW, HIGH) NAME,
enum { NUMERIC_TYPES(NUMBER) };
#undef NUMBER

static void note(Adapter *a, fmi3Status status, const char *text) { keep_message(a->log, (int32_t)status, text); }

static fmi3Status unfit(Adapter *a, const Array *array, double value, const char *what)
{
    char text[160];
    snprintf(text, sizeof text, "%.15g, of value reference %u, %s", value, (unsigned)array->reference, what);
    note(a, fmi3Error, text);
    return fmi3Error;
}

/* One call for the `n` references gathered in `references`, which have `total` values, in `chosen` order. */
#define ACCESS(NAME, LOW, HIGH)                                                                                       \
    static fmi3Status get_##NAME(Adapter *a, size_t n, size_t total)                                                  \
    {                                                                                                                 \
        fmi3##NAME *typed = a->typed;                                                                                 \
        const fmi3Status s = ((fmi3Get##NAME##TYPE *)a->get[NAME])(a->fmu, a->references, n, typed, total);            \
        for (size_t i = 0, at = 0; i < n && s <= fmi3Warning; ++i) {                                                  \
            const Array *array = a->arrays + a->chosen[i];                                                            \
            for (int32_t e = 0; e < array->size; ++e) a->values[array->first + e] = (double)typed[at++];              \
        }                                                                                                             \
        return s;                                                                                                     \
    }                                                                                                                 \
    static fmi3Status set_##NAME(Adapter *a, size_t n, size_t total)                                                  \
    {                                                                                                                 \
        fmi3##NAME *typed = a->typed;                                                                                 \
        for (size_t i = 0, at = 0; i < n; ++i) {                                                                      \
            const Array *array = a->arrays + a->chosen[i];                                                            \
            for (int32_t e = 0; e < array->size; ++e) {                                                               \
                const double v = a->values[array->first + e];                                                         \
                if (v < (LOW) || v > (HIGH)) return unfit(a, array, v, "does not fit the type " #NAME);               \
                typed[at++] = (fmi3##NAME)v;                                                                          \
            }                                                                                                         \
        }                                                                                                             \
        return ((fmi3Set##NAME##TYPE *)a->set[NAME])(a->fmu, a->references, n, typed, total);                          \
    }
NUMERIC_TYPES(ACCESS)
#undef ACCESS

typedef fmi3Status access_function(Adapter *a, size_t n, size_t total);
#define GETTER(NAME, LOW, HIGH) get_##NAME,
#define SETTER(NAME, LOW, HIGH) set_##NAME,
static access_function *const getters[] = {NUMERIC_TYPES(GETTER)}, *const setters[] = {NUMERIC_TYPES(SETTER)};

/* List the arrays that have these elements, each once, in `listed`; returns how many. */
static size_t list_arrays(Adapter *a, const uint32_t *elements, size_t n)
{
    size_t count = 0;
    a->round += 1;
    for (size_t i = 0; i < n; ++i) {
        const int32_t k = a->array_of[elements[i]];
        if (a->seen[k] == a->round) continue;
        a->seen[k] = a->round;
        a->listed[count++] = k;
    }
    return count;
}

/* Read or set the listed arrays: one call for each type among them. */
static fmi2Status access(Adapter *a, access_function *const *functions, size_t count)
{
    fmi3Status worst = fmi3OK;
    for (size_t left = count; left > 0;) {
        const int32_t type = a->arrays[a->listed[0]].type;
        size_t n = 0, total = 0, others = 0;
        for (size_t i = 0; i < left; ++i) {
            const Array *array = a->arrays + a->listed[i];
            if (array->type != type) {
                a->listed[others++] = a->listed[i];
                continue;
            }
            a->chosen[n] = a->listed[i];
            a->references[n++] = array->reference;
            total += (size_t)array->size;
        }
        const fmi3Status s = functions[type](a, n, total);
        if (s > fmi3Warning) return (fmi2Status)s;
        if (s > worst) worst = s;
        left = others;
    }
    return (fmi2Status)worst;
}

#define GET(NAME, TYPE)                                                                                               \
    EXPORT fmi2Status adapter_##NAME(fmi2Component c, const fmi2ValueReference r[], size_t n, TYPE v[])               \
    {                                                                                                                 \
        Adapter *a = c;                                                                                               \
        const fmi2Status s = access(a, getters, list_arrays(a, r, n));                                                \
        for (size_t i = 0; i < n && s <= fmi2Warning; ++i) v[i] = (TYPE)a->values[r[i]];                              \
        return s;                                                                                                     \
    }
#define SET(NAME, TYPE)                                                                                               \
    EXPORT fmi2Status adapter_##NAME(fmi2Component c, const fmi2ValueReference r[], size_t n, const TYPE v[])         \
    {                                                                                                                 \
        Adapter *a = c;                                                                                               \
        for (size_t i = 0; i < n; ++i) a->values[r[i]] = (double)v[i];                                                \
        return access(a, setters, list_arrays(a, r, n));                                                              \
    }
/* Integers pass as reals: they may have more than the 32 bits of FMI 2.0. */
GET(get_real, fmi2Real)
GET(get_boolean, fmi2Boolean)
SET(set_real, fmi2Real)
SET(set_boolean, fmi2Boolean)

/* Of orders 1 and 2, for the next step; those of order 1 come first. */
EXPORT fmi2Status adapter_set_slopes(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer orders[],
                                     const fmi2Real v[])
{
    Adapter *a = c;
    if (n > 0 && orders[0] == 1) a->n_moving = 0;
    for (size_t i = 0; i < n; ++i) {
        if (orders[i] == 2) {
            a->bend[r[i]] = 0.5 * v[i];
            continue;
        }
        a->slope[r[i]] = v[i];
        a->bend[r[i]] = 0.0;
        a->moving[a->n_moving++] = r[i];
    }
    return fmi2OK;
}

/* What FMUs call within a step, for the inputs of then. */
EXPORT void adapter_update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set_requested,
                           fmi3Boolean get_allowed, fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early,
                           fmi3Float64 *when)
{
    Adapter *a = environment;
    (void)get_allowed, (void)finished, (void)can_return, (void)when;
    if (early) *early = fmi3False;
    if (!set_requested || a->n_moving == 0) return;
    const double tau = time - a->begin;
    for (size_t i = 0; i < a->n_moving; ++i) {
        const uint32_t e = a->moving[i];
        a->values[e] = a->base[e] + tau * (a->slope[e] + tau * a->bend[e]);
    }
    const fmi2Status s = access(a, setters, list_arrays(a, a->moving, a->n_moving));
    if (s > fmi2Warning) a->failed = s;
}

EXPORT fmi2Status adapter_do_step(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    Adapter *a = c;
    fmi3Boolean event = fmi3False, end = fmi3False, early = fmi3False;
    fmi3Float64 reached = time + step;
    char text[160];
    a->begin = time;
    a->failed = fmi2OK;
    for (size_t i = 0; i < a->n_moving; ++i) a->base[a->moving[i]] = a->values[a->moving[i]];
    const fmi3Status s = a->do_step(a->fmu, time, step, final != fmi2False, &event, &end, &early, &reached);
    a->n_moving = 0;
    if (s > fmi3Warning || a->failed > fmi2Warning) return s > fmi3Warning ? (fmi2Status)s : a->failed;
    if (!end && !early) return (fmi2Status)s;
    snprintf(text, sizeof text, end ? "it asks to end the simulation at %g s" : "it returned early, at %g s", reached);
    note(a, fmi3Discard, text);
    return fmi2Discard;
}

EXPORT fmi2Status adapter_get_state(fmi2Component c, fmi2FMUstate *state)
{
    return (fmi2Status)((Adapter *)c)->get_state(((Adapter *)c)->fmu, state);
}

EXPORT fmi2Status adapter_set_state(fmi2Component c, fmi2FMUstate state)
{
    return (fmi2Status)((Adapter *)c)->set_state(((Adapter *)c)->fmu, state);
}

EXPORT fmi2Status adapter_free_state(fmi2Component c, fmi2FMUstate *state)
{
    return (fmi2Status)((Adapter *)c)->free_state(((Adapter *)c)->fmu, state);
}

/* Place of each listed array's first element among all of them, in `place`; returns how many elements these have. */
static size_t lay_out(Adapter *a, size_t count, uint32_t *references)
{
    size_t total = 0;
    for (size_t i = 0; i < count; ++i) {
        const Array *array = a->arrays + a->listed[i];
        references[i] = array->reference;
        a->place[a->listed[i]] = total;
        total += (size_t)array->size;
    }
    return total;
}

static double *spot(const Adapter *a, double *values, uint32_t element)
{
    const int32_t k = a->array_of[element];
    return values + a->place[k] + (element - (uint32_t)a->arrays[k].first);
}

EXPORT fmi2Status adapter_directional(fmi2Component c, const fmi2ValueReference unknowns[], size_t n,
                                      const fmi2ValueReference knowns[], size_t m, const fmi2Real seed[],
                                      fmi2Real derivative[])
{
    Adapter *a = c;
    double *seeds = a->seeds, *results = a->typed;
    const size_t n_known = list_arrays(a, knowns, m);
    const size_t n_seeds = lay_out(a, n_known, a->known);
    memset(seeds, 0, n_seeds * sizeof *seeds);
    for (size_t i = 0; i < m; ++i) *spot(a, seeds, knowns[i]) = seed[i];
    const size_t n_sought = list_arrays(a, unknowns, n);
    const size_t n_results = lay_out(a, n_sought, a->references);
    const fmi3Status s = a->directional(a->fmu, a->references, n_sought, a->known, n_known, seeds, n_seeds, results,
                                        n_results);
    for (size_t i = 0; i < n && s <= fmi3Warning; ++i) derivative[i] = *spot(a, results, unknowns[i]);
    return (fmi2Status)s;
}

/* The logger that FMUs call. */
EXPORT void adapter_log(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)category;
    if (environment && message && status != fmi3OK) note(environment, status, message);
}
