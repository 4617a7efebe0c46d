/* FMI 2.0, Co-Simulation and Model Exchange: its functions in terms of instance.h. */
#include "fmi2Functions.h"
#include "instance.h"

#ifdef _WIN32
enum { ON_WINDOWS = 1 };
#else
enum { ON_WINDOWS = 0 };
#endif
#define MAX_PATH_LENGTH 4096

static fmi2Status status(int failed) { return failed ? fmi2Error : fmi2OK; }

void deliver(const instance *m, const char *text)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)m->logger;
    if (!logger) return;
    /* The text itself is the format, since many importers do not expand arguments; so percent signs are doubled. */
    char escaped[2048], *to = escaped;
    for (const char *from = text; *from && to < escaped + sizeof escaped - 2; from++) {
        if (*from == '%') *to++ = '%';
        *to++ = *from;
    }
    *to = 0;
    logger(m->environment, m->name, fmi2Error, "logStatusError", escaped);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

static int digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    c |= 32;
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* The path that a file URI names (RFC 8089), in the buffer; "" if it names none here. What is no URI is a path. */
static const char *path_of(const char *uri, char *path, size_t size)
{
    const int encoded = uri && !strncmp(uri, "file:", 5);
    const char *from = !uri ? "" : encoded ? uri + 5 : uri;
    size_t n = 0;
    if (encoded && !strncmp(from, "//", 2)) {
        if (from[2] == '/') from += 2;
        else if (!strncmp(from, "//localhost/", 12)) from += 11;
        else if (!ON_WINDOWS) return ""; /* another machine; Windows opens it as //machine/share */
    }
    for (; *from && n < size - 1; from++) {
        char c = *from;
        if (encoded && c == '%' && digit(from[1]) >= 0 && digit(from[2]) >= 0) {
            c = (char)(16 * digit(from[1]) + digit(from[2]));
            if (!c) return "";
            from += 2;
        }
        path[n++] = c;
    }
    path[n] = 0;
    if (*from) return "";
    return ON_WINDOWS && encoded && path[0] == '/' && n > 2 && path[2] == ':' ? path + 1 : path; /* /C:/... */
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)visible, (void)logging; /* what is logged are errors: always */
    char path[MAX_PATH_LENGTH];
    const char *folder = path_of(resources, path, sizeof path);
    if (!callbacks) return create(name, guid, folder, type == fmi2ModelExchange, NULL, NULL);
    return create(name, guid, folder, type == fmi2ModelExchange, callbacks->componentEnvironment,
                  (void (*)(void))callbacks->logger);
}

void fmi2FreeInstance(fmi2Component c) { destroy(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)on, (void)n, (void)categories;
    return status(!c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance, (void)tolerance;
    return status(!c || set_up(c, "fmi2SetupExperiment", begin, has_stop, stop));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return status(!c || begin_initialisation(c, "fmi2EnterInitializationMode"));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return status(!c || end_initialisation(c, "fmi2ExitInitializationMode"));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    if (!c) return fmi2Error;
    terminate(c);
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    if (!c) return fmi2Error;
    return status(restart(c) && report(c, "out of memory"));
}

/* Variables */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    if (!c) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(c, "fmi2GetReal", vr[i], REAL, value) || require(c, (int)vr[i])) return fmi2Error;
        value[i] = value_of(c, (int)vr[i]);
    }
    return fmi2OK;
}

static fmi2Status get_whole(instance *m, const char *function, const fmi2ValueReference vr[], size_t n,
                            variable_kind kind, int value[])
{
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(m, function, vr[i], kind, value) || require(m, (int)vr[i])) return fmi2Error;
        value[i] = (int)value_of(m, (int)vr[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    return get_whole(c, "fmi2GetInteger", vr, n, INTEGER, value);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    return get_whole(c, "fmi2GetBoolean", vr, n, BOOLEAN, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    instance *m = c;
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (!value || vr[i] >= (unsigned)model.n_strings) return status(unknown(m, "fmi2GetString", vr[i], value));
        value[i] = m->strings[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    if (!c) return fmi2Error;
    for (size_t i = 0; i < n; i++)
        if (check(c, "fmi2SetReal", vr[i], REAL, value) || assign(c, "fmi2SetReal", (int)vr[i], value[i]))
            return fmi2Error;
    return fmi2OK;
}

static fmi2Status set_whole(instance *m, const char *function, const fmi2ValueReference vr[], size_t n,
                            variable_kind kind, const int value[])
{
    if (!m) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (check(m, function, vr[i], kind, value)) return fmi2Error;
        if (assign(m, function, (int)vr[i], kind == BOOLEAN ? value[i] != 0 : value[i])) return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    return set_whole(c, "fmi2SetInteger", vr, n, INTEGER, value);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    return set_whole(c, "fmi2SetBoolean", vr, n, BOOLEAN, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    if (!c) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (!value || vr[i] >= (unsigned)model.n_strings) return status(unknown(c, "fmi2SetString", vr[i], value));
        if (set_string(c, "fmi2SetString", vr[i], value[i])) return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    const char *function = "fmi2SetRealInputDerivatives";
    if (!c) return fmi2Error;
    for (size_t i = 0; i < n; i++)
        if (check(c, function, vr[i], REAL, order && value ? value : NULL)
            || set_slope(c, function, (int)vr[i], order[i], value[i]))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return status(!c || report(c, "fmi2GetRealOutputDerivatives: not provided (maxOutputDerivativeOrder is 0)"));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference sought[], size_t n_sought,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real dknown[],
                                        fmi2Real dsought[])
{
    const char *function = "fmi2GetDirectionalDerivative";
    int purposes = 0;
    if (!c || directional_begin(c, function)) return fmi2Error;
    for (size_t i = 0; i < n_known; i++)
        if (check(c, function, known[i], REAL, dknown) || directional_seed(c, function, (int)known[i], dknown[i]))
            return fmi2Error;
    for (size_t i = 0; i < n_sought; i++) {
        if (check(c, function, sought[i], REAL, dsought)) return fmi2Error;
        purposes |= model.variables[sought[i]].role == RATE ? FOR_RATES : FOR_OUTPUTS;
    }
    if (directional_evaluate(c, function, purposes)) return fmi2Error;
    for (size_t i = 0; i < n_sought; i++)
        if (directional_result(c, function, (int)sought[i], &dsought[i])) return fmi2Error;
    return fmi2OK;
}

/* The FMU's state */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return status(!c || !state || get_state(c, state)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return status(!c || !state || set_state(c, state)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!c || !state) return fmi2Error;
    free_state(c, state);
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    if (!c || !state || !size) return fmi2Error;
    *size = state_size(state);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return status(!c || !state || !bytes || write_state(c, state, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return status(!c || !bytes || !state || read_state(c, "fmi2DeSerializeFMUstate", bytes, size, state));
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real length, fmi2Boolean no_rollback)
{
    (void)no_rollback;
    return status(!c || step(c, "fmi2DoStep", now, length));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return status(!c || report(c, "fmi2CancelStep: steps are synchronous")); }

static fmi2Status no_status(fmi2Component c) { return c ? fmi2Discard : fmi2Error; }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
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
    (void)kind, (void)value;
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
    (void)kind, (void)value;
    return no_status(c);
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return status(!c || enter_event_mode(c, "fmi2EnterEventMode")); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    int has_next;
    double next = 0.0;
    if (!c || !info || update_discrete(c, "fmi2NewDiscreteStates", &has_next, &next)) return fmi2Error;
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = has_next ? fmi2True : fmi2False;
    info->nextEventTime = next;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return status(!c || enter_continuous_mode(c, "fmi2EnterContinuousTimeMode"));
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_rollback, fmi2Boolean *event, fmi2Boolean *end)
{
    (void)no_rollback;
    int due;
    if (!c || !event || !end || complete_step(c, "fmi2CompletedIntegratorStep", &due)) return fmi2Error;
    *event = due ? fmi2True : fmi2False;
    *end = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return status(!c || set_time(c, "fmi2SetTime", time)); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    return status(!c || set_states(c, "fmi2SetContinuousStates", x, n));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    return status(!c || get_states(c, "fmi2GetContinuousStates", x, n));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    return status(!c || get_nominals(c, "fmi2GetNominalsOfContinuousStates", nominals, n));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real rates[], size_t n)
{
    return status(!c || get_rates(c, "fmi2GetDerivatives", rates, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    return status(!c || get_indicators(c, "fmi2GetEventIndicators", indicators, n));
}
