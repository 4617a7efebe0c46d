/* FMI 3.0, Co-Simulation and Model Exchange: its functions in terms of instance.h.
 *
 * A variable's value reference is the place of its first element; those of texts follow. fmi3_unused.c has the
 * functions for what these FMUs do not have. */
#include "fmi3Functions.h"
#include "instance.h"

static fmi3Status status(int failed) { return failed ? fmi3Error : fmi3OK; }

void deliver(const instance *m, const char *text)
{
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)m->logger;
    if (logger) logger(m->environment, fmi3Error, "logStatusError", text);
}

static void ask(instance *m, double time)
{
    fmi3Boolean early = fmi3False;
    fmi3Float64 when = time;
    ((fmi3IntermediateUpdateCallback)m->update)(m->environment, time, fmi3True, fmi3False, fmi3False, fmi3False, &early,
                                                &when);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger)
{
    (void)visible, (void)logging; /* what is logged are errors: always */
    return create(name, token, resources, 1, environment, (void (*)(void))logger);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update)
{
    const char *function = "fmi3InstantiateCoSimulation";
    (void)visible, (void)logging, (void)early_return;
    instance *m = create(name, token, resources, 0, environment, (void (*)(void))logger);
    if (!m) return NULL;
    int failed = event_mode && report(m, "%s: event mode is not provided", function), inputs = 0;
    for (size_t i = 0; i < n_intermediate && !failed; i++) { /* others than inputs are never offered for reading */
        const fmi3ValueReference vr = intermediate[i];
        if (vr >= (unsigned)(model.n_variables + model.n_strings)) failed = unknown(m, function, vr, intermediate);
        else inputs |= vr < (unsigned)model.n_variables && model.variables[vr].role == INPUT;
    }
    if (inputs && !update) failed = report(m, "%s: inputs within a step, but no callback to set them", function);
    if (failed) {
        destroy(m);
        return NULL;
    }
    m->update = (void (*)(void))update;
    m->ask = inputs ? ask : NULL;
    return m;
}

void fmi3FreeInstance(fmi3Instance c) { destroy(c); }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)on, (void)n, (void)categories;
    return status(!c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 begin, fmi3Boolean has_stop, fmi3Float64 stop)
{
    const char *function = "fmi3EnterInitializationMode";
    (void)has_tolerance, (void)tolerance;
    return status(!c || set_up(c, function, begin, has_stop, stop) || begin_initialisation(c, function));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    return status(!c || end_initialisation(c, "fmi3ExitInitializationMode"));
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    if (!c) return fmi3Error;
    terminate(c);
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    if (!c) return fmi3Error;
    return status(restart(c) && report(c, "out of memory"));
}

/* Variables */

/* Elements of a variable, all of which are to fit among those left; 0 after a reported error. */
static size_t span(instance *m, const char *function, fmi3ValueReference vr, variable_kind kind, const void *values,
                   size_t left)
{
    if (check(m, function, vr, kind, values)) return 0;
    const size_t size = (size_t)model.variables[vr].size;
    if (!size) unknown(m, function, vr, values); /* an element within an array */
    if (size > left)
        report(m, "%s: too few values: the array of %s has %u", function, model.variables[vr].name, (unsigned)size);
    return size > left ? 0 : size;
}

static fmi3Status all_used(instance *m, const char *function, size_t used, size_t given)
{
    if (used == given) return fmi3OK;
    return status(report(m, "%s: %u values for %u elements", function, (unsigned)given, (unsigned)used));
}

#define GETTER(NAME, TYPE, KIND)                                                                                      \
    fmi3Status NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, TYPE value[], size_t n_values)           \
    {                                                                                                                 \
        size_t at = 0;                                                                                                \
        if (!c) return fmi3Error;                                                                                     \
        for (size_t i = 0; i < n; i++) {                                                                              \
            const size_t size = span(c, #NAME, vr[i], KIND, value, n_values - at);                                    \
            if (!size || require(c, (int)vr[i])) return fmi3Error;                                                    \
            for (size_t e = 0; e < size; e++) value[at++] = (TYPE)value_of(c, (int)(vr[i] + e));                      \
        }                                                                                                             \
        return all_used(c, #NAME, at, n_values);                                                                      \
    }

#define SETTER(NAME, TYPE, KIND)                                                                                      \
    fmi3Status NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const TYPE value[], size_t n_values)     \
    {                                                                                                                 \
        size_t at = 0;                                                                                                \
        if (!c) return fmi3Error;                                                                                     \
        for (size_t i = 0; i < n; i++) {                                                                              \
            const size_t size = span(c, #NAME, vr[i], KIND, value, n_values - at);                                    \
            if (!size) return fmi3Error;                                                                              \
            for (size_t e = 0; e < size; e++)                                                                         \
                if (assign(c, #NAME, (int)(vr[i] + e), (double)value[at++])) return fmi3Error;                        \
        }                                                                                                             \
        return all_used(c, #NAME, at, n_values);                                                                      \
    }

GETTER(fmi3GetFloat64, fmi3Float64, REAL)
GETTER(fmi3GetInt32, fmi3Int32, INTEGER)
GETTER(fmi3GetBoolean, fmi3Boolean, BOOLEAN)
SETTER(fmi3SetFloat64, fmi3Float64, REAL)
SETTER(fmi3SetInt32, fmi3Int32, INTEGER)
SETTER(fmi3SetBoolean, fmi3Boolean, BOOLEAN)

static int text_at(instance *m, const char *function, fmi3ValueReference vr, const void *values, size_t *i)
{
    *i = (size_t)vr - (size_t)model.n_variables;
    return values && *i < (size_t)model.n_strings ? 0 : unknown(m, function, vr, values);
}

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String value[], size_t n_values)
{
    size_t at;
    if (!c || all_used(c, "fmi3GetString", n, n_values) != fmi3OK) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (text_at(c, "fmi3GetString", vr[i], value, &at)) return fmi3Error;
        value[i] = ((instance *)c)->strings[at];
    }
    return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String value[],
                         size_t n_values)
{
    const char *function = "fmi3SetString";
    size_t at;
    if (!c || all_used(c, function, n, n_values) != fmi3OK) return fmi3Error;
    for (size_t i = 0; i < n; i++)
        if (text_at(c, function, vr[i], value, &at) || set_string(c, function, at, value[i])) return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference sought[], size_t n_sought,
                                        const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
                                        size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    const char *function = "fmi3GetDirectionalDerivative";
    int purposes = 0;
    size_t at = 0;
    if (!c || directional_begin(c, function)) return fmi3Error;
    for (size_t i = 0; i < n_known; i++) {
        const size_t size = span(c, function, known[i], REAL, seed, n_seed - at);
        if (!size) return fmi3Error;
        for (size_t e = 0; e < size; e++)
            if (directional_seed(c, function, (int)(known[i] + e), seed[at++])) return fmi3Error;
    }
    if (all_used(c, function, at, n_seed) != fmi3OK) return fmi3Error;
    for (size_t i = 0; i < n_sought; i++) {
        if (check(c, function, sought[i], REAL, sensitivity)) return fmi3Error;
        purposes |= model.variables[sought[i]].role == RATE ? FOR_RATES : FOR_OUTPUTS;
    }
    if (directional_evaluate(c, function, purposes)) return fmi3Error;
    at = 0;
    for (size_t i = 0; i < n_sought; i++) {
        const size_t size = span(c, function, sought[i], REAL, sensitivity, n_sensitivity - at);
        if (!size) return fmi3Error;
        for (size_t e = 0; e < size; e++, at++)
            if (directional_result(c, function, (int)(sought[i] + e), &sensitivity[at])) return fmi3Error;
    }
    return all_used(c, function, at, n_sensitivity);
}

/* The FMU's state */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return status(!c || !state || get_state(c, state)); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return status(!c || !state || set_state(c, state)); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    if (!c || !state) return fmi3Error;
    free_state(c, state);
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    if (!c || !state || !size) return fmi3Error;
    *size = state_size(state);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    return status(!c || !state || !bytes || write_state(c, state, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    return status(!c || !bytes || !state || read_state(c, "fmi3DeserializeFMUState", bytes, size, state));
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 length, fmi3Boolean no_rollback, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)no_rollback;
    if (!c || !event || !end || !early || !reached) return fmi3Error;
    *event = *end = *early = fmi3False;
    const int failed = step(c, "fmi3DoStep", now, length);
    *reached = ((instance *)c)->s.time;
    return status(failed);
}

/* Model exchange */

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return status(!c || enter_event_mode(c, "fmi3EnterEventMode")); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *new_nominals,
                                    fmi3Boolean *new_states, fmi3Boolean *has_next, fmi3Float64 *next)
{
    int defined;
    if (!c || !again || !end || !new_nominals || !new_states || !has_next || !next) return fmi3Error;
    if (update_discrete(c, "fmi3UpdateDiscreteStates", &defined, next)) return fmi3Error;
    *again = *end = *new_nominals = *new_states = fmi3False;
    *has_next = defined ? fmi3True : fmi3False;
    return fmi3OK;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { return status(!c || exchanged(c, __func__, EVENT, EVENT)); }

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
    return status(!c || enter_continuous_mode(c, "fmi3EnterContinuousTimeMode"));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_rollback, fmi3Boolean *event, fmi3Boolean *end)
{
    (void)no_rollback;
    int due;
    if (!c || !event || !end || complete_step(c, "fmi3CompletedIntegratorStep", &due)) return fmi3Error;
    *event = due ? fmi3True : fmi3False;
    *end = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return status(!c || set_time(c, "fmi3SetTime", time)); }

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{
    return status(!c || set_states(c, "fmi3SetContinuousStates", x, n));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n)
{
    return status(!c || get_states(c, "fmi3GetContinuousStates", x, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n)
{
    return status(!c || get_nominals(c, "fmi3GetNominalsOfContinuousStates", nominals, n));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 rates[], size_t n)
{
    return status(!c || get_rates(c, "fmi3GetContinuousStateDerivatives", rates, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n)
{
    return status(!c || get_indicators(c, "fmi3GetEventIndicators", indicators, n));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    if (!c || !n) return fmi3Error;
    *n = (size_t)model.n_switches;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    if (!c || !n) return fmi3Error;
    *n = (size_t)model.n_x;
    return fmi3OK;
}
