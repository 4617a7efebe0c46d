/* A foreign FMU of FMI 3.0 with an array of two for each numeric type: what is set comes out after the next step, and
 * `level` at once. It asks for its real inputs in the middle of each step and keeps their mean over it (Simpson's rule).
 * Value references: see relay.py. */
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

#define TYPES(X) X(Float64, 0) X(Float32, 1) X(Int8, 2) X(UInt8, 3) X(Int16, 4) X(UInt16, 5) X(Int32, 6) X(UInt32, 7) \
    X(Int64, 8) X(UInt64, 9) X(Boolean, 10)
enum { N_TYPES = 11, LENGTH = 2, OUT = 20, FAIL_AT = 40, HOW, MEAN, LEVEL, LABEL };

typedef struct {
    double in[N_TYPES][LENGTH], out[N_TYPES][LENGTH], fail_at, mean[LENGTH];
    int32_t how; /* 1: end, 2: early return, 3: error, 4: a warning, 5: abort, 6: refuse inputs within the step */
    int stepping;
    char label[64];
    int within;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
} relay;

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference asked[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)visible, (void)logging, (void)asked;
    const size_t length = strlen(resources);
    if (strcmp(token, "relay") || events || early || resources[length - 1] != '/') return NULL;
    relay *r = calloc(1, sizeof *r);
    r->environment = environment, r->log = log, r->update = update, r->within = n > 0, r->fail_at = 1e9, r->in[0][1] = 0.25;
    return r;
}

static double *place(relay *r, fmi3ValueReference vr, int type, size_t *length)
{
    *length = LENGTH;
    if (vr == (fmi3ValueReference)type) return r->in[type];
    if (vr == (fmi3ValueReference)(OUT + type)) return r->out[type];
    if (type == 0 && vr == MEAN) return r->mean;
    *length = 1;
    if (type == 0 && vr == FAIL_AT) return &r->fail_at;
    if (type == 0 && vr == LEVEL) return r->in[0];
    return NULL;
}

#define ACCESS(T, K)                                                                                                  \
    fmi3Status fmi3Get##T(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##T v[], size_t n_values)      \
    {                                                                                                                 \
        size_t at = 0, length;                                                                                        \
        for (size_t i = 0; i < n; i++) {                                                                              \
            const double *from = place(c, vr[i], K, &length);                                                         \
            if (!from || at + length > n_values) return fmi3Error;                                                    \
            for (size_t e = 0; e < length; e++) v[at++] = (fmi3##T)from[e];                                           \
        }                                                                                                             \
        return at == n_values ? fmi3OK : fmi3Error;                                                                   \
    }                                                                                                                 \
    fmi3Status fmi3Set##T(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##T v[], size_t n_values)\
    {                                                                                                                 \
        relay *r = c;                                                                                                 \
        size_t at = 0, length;                                                                                        \
        for (size_t i = 0; i < n; i++) {                                                                              \
            if (K == 6 && vr[i] == HOW) { r->how = (int32_t)v[at++]; continue; }                                       \
            double *to = place(r, vr[i], K, &length);                                                                 \
            if (r->stepping && r->how == 6) return fmi3Error;                                                         \
            if (!to || at + length > n_values) return fmi3Error;                                                      \
            for (size_t e = 0; e < length; e++) to[e] = (double)v[at++];                                              \
        }                                                                                                             \
        return at == n_values ? fmi3OK : fmi3Error;                                                                   \
    }
TYPES(ACCESS)

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String v[], size_t n_values)
{
    if (n != 1 || n_values != 1 || vr[0] != LABEL || strlen(v[0]) > 63) return fmi3Error;
    strcpy(((relay *)c)->label, v[0]);
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean t, fmi3Float64 x, fmi3Float64 s, fmi3Boolean e, fmi3Float64 z)
{
    (void)c, (void)t, (void)x, (void)e, (void)z;
    return s == 0.0 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
fmi3Status fmi3Terminate(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
void fmi3FreeInstance(fmi3Instance c) { free(c); }

static void at_time(relay *r, double time, double *values)
{
    fmi3Boolean early = fmi3False;
    fmi3Float64 when = time;
    if (r->within) r->update(r->environment, time, fmi3True, fmi3False, fmi3False, fmi3False, &early, &when);
    memcpy(values, r->in[0], sizeof r->in[0]);
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *reached)
{
    relay *r = c;
    double a[LENGTH], b[LENGTH], d[LENGTH];
    (void)keep;
    r->stepping = t + h >= r->fail_at;
    at_time(r, t, a), at_time(r, t + h / 2, b), at_time(r, t + h, d);
    r->stepping = 0;
    for (int e = 0; e < LENGTH; e++) r->mean[e] = (a[e] + 4 * b[e] + d[e]) / 6;
    memcpy(r->out, r->in, sizeof r->out);
    *event = fmi3False, *end = fmi3False, *early = fmi3False, *reached = t + h;
    if (t + h < r->fail_at) return fmi3OK;
    *end = r->how == 1, *early = r->how == 2;
    if (r->how == 2) *reached = t + h / 2;
    if (r->how < 3 || r->how > 5) return fmi3OK;
    if (r->how == 5) abort();
    r->log(r->environment, r->how == 3 ? fmi3Error : fmi3Warning, "logAll", r->label[0] ? r->label : "100 % done");
    return r->how == 3 ? fmi3Error : fmi3Warning;
}
