/* A foreign FMU that goes wrong on demand: `fault` names how, `fault_at` when. Value references: test_isolation.py.
 * Its state can be saved, it differentiates (x with respect to u: the gain), and it talks on stdout and stderr. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <windows.h>
#else
#include <unistd.h>
#endif
#include "fmi2Functions.h"

enum { U, X, FAULT_AT, GAIN, REALS };
enum { NONE, NULL_POINTER, EXIT, HANG, ERROR, ABORT, CRASH_IN_INITIALISATION, FATAL, CRASH_IN_GET };

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    double real[REALS];
    int fault;
} probe;

static int instances;

static void say(const probe *p, fmi2Status status, const char *text)
{
    const fmi2CallbackFunctions *b = p->callbacks;
    b->logger(b->componentEnvironment, "probe", status, "logStatusError", "%s", text);
}

static void write_to_null(void)
{
    int *volatile nowhere = NULL;
    *nowhere = 1;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    probe *p = calloc(1, sizeof *p);
    p->callbacks = callbacks;
    p->real[U] = 1.0;
    p->real[FAULT_AT] = 1e9;
    p->real[GAIN] = 1.0;
    if (++instances == 1) return p;
    say(p, fmi2Error, "one instance in this process is all I can");
    free(p);
    return NULL;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    const probe *p = c;
    if (p->fault == CRASH_IN_GET && p->real[X] > 0.0) write_to_null();
    for (size_t i = 0; i < n; i++) v[i] = p->real[r[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    for (size_t i = 0; i < n; i++) ((probe *)c)->real[r[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{
    for (size_t i = 0; i < n; i++) ((probe *)c)->fault = v[i];
    return r && n < 2 ? fmi2OK : fmi2Error;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    if (((probe *)c)->fault == CRASH_IN_INITIALISATION) write_to_null();
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    probe *p = c;
    (void)keep;
    printf("a line on stdout at t = %g s\n", t);
    fflush(stdout);
    if (t + h > p->real[FAULT_AT] + 1e-9) {
        switch (p->fault) {
        case NULL_POINTER: write_to_null(); break;
        case EXIT: exit(3);
        case HANG:
            for (;;)
#if defined(_WIN32)
                Sleep(1000);
#else
                sleep(1);
#endif
        case ERROR:
            say(p, fmi2Error, "the valve is jammed");
            return fmi2Error;
        case FATAL: return fmi2Fatal;
        case ABORT:
            say(p, fmi2Error, "pressure lost");
            fprintf(stderr, "probe.c:77: assertion failed: pressure > 0\n");
            abort();
        default: break;
        }
    }
    p->real[X] += h * p->real[GAIN] * p->real[U];
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state) *state = malloc(sizeof(probe));
    memcpy(*state, c, sizeof(probe));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(probe));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
    return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real seed[],
                                        fmi2Real derivative[])
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = derivative[i] = 0; j < m; j++)
            if (unknown[i] == X && known[j] == U) derivative[i] += ((probe *)c)->real[GAIN] * seed[j];
    return fmi2OK;
}

/* The rest does nothing; what the master does not need is not provided. */
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{
    (void)a, (void)b, (void)d, (void)e, (void)f;
    return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{
    (void)r, (void)v;
    return c && !n ? fmi2OK : fmi2Error;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{
    (void)r, (void)v;
    return c && !n ? fmi2OK : fmi2Error;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{
    (void)r, (void)v;
    return c && !n ? fmi2OK : fmi2Error;
}
