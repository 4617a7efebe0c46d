/* A foreign FMU for the tests of the master: it holds its inputs, counts with integers and booleans, and fails on
 * demand. Value references: see cosim_fmus.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { U, INTEGRAL, THROUGH, SLOPE, INTERCEPT, FAIL_AT, MASS, REALS };
enum { COUNT, NUMBER, FAIL_STATUS, INTEGERS };
enum { GATE, OPEN, BOOLEANS };
enum { NAN_STATUS = 9 };

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    double real[REALS];
    int integer[INTEGERS];
    int boolean[BOOLEANS];
} probe;

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    probe *p = calloc(1, sizeof *p);
    p->callbacks = callbacks;
    p->real[FAIL_AT] = 1e9;
    return p;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    probe *p = c;
    p->real[THROUGH] = p->real[SLOPE] * p->real[U] + p->real[INTERCEPT];
    for (size_t i = 0; i < n; i++) v[i] = p->real[r[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    for (size_t i = 0; i < n; i++) ((probe *)c)->real[r[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{
    for (size_t i = 0; i < n; i++) v[i] = ((probe *)c)->integer[r[i]];
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{
    for (size_t i = 0; i < n; i++) ((probe *)c)->integer[r[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{
    for (size_t i = 0; i < n; i++) v[i] = ((probe *)c)->boolean[r[i]];
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{
    for (size_t i = 0; i < n; i++) ((probe *)c)->boolean[r[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    probe *p = c;
    (void)keep;
    if (t + h > p->real[FAIL_AT]) {
        const fmi2CallbackFunctions *b = p->callbacks;
        if (p->integer[FAIL_STATUS] == NAN_STATUS) {
            p->real[INTEGRAL] = NAN;
            return fmi2OK;
        }
        b->logger(b->componentEnvironment, "probe", fmi2Error, "logStatusError", "valve %d jammed at %.1f bar", 3, 7.5);
        return (fmi2Status)p->integer[FAIL_STATUS];
    }
    p->real[INTEGRAL] += h * p->real[U];
    p->integer[NUMBER] = p->integer[COUNT] + 1;
    p->boolean[OPEN] = !p->boolean[GATE];
    return fmi2OK;
}

/* The rest does nothing; what the master does not need is not provided. */
#define ANY (fmi2Component c)
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2EnterInitializationMode ANY { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2ExitInitializationMode ANY { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2Terminate ANY { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2Reset ANY { return c ? fmi2Error : fmi2Fatal; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String s[])
{
    (void)on, (void)n, (void)s;
    return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{
    (void)a, (void)b, (void)d, (void)e, (void)f;
    return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{
    (void)c, (void)r, (void)v;
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{
    (void)r, (void)n, (void)v;
    return c ? fmi2OK : fmi2Error;
}
