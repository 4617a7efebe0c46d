/* A tuned mass damper as a colleague might hand it over: FMI 2.0 written by hand, with names and units of its own
 * (mm, t, kN, deg). The equations are those of fmus_src/tmd/model.py. Value references: see foreign_damper.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { ACC, RATE = 3, SPIN = 6, FORCE = 9, MOMENT = 12, TRAVEL = 15, SPEED, HEAT, MASS, STIFFNESS, DAMPING, STROKE,
       STOP_STIFFNESS, STOP_DAMPING, REALS };
static const double DEG = 0.017453292519943295;

typedef struct { double real[REALS], x, v, heat; } damper;

static void start(damper *d)
{
    static const double values[] = {[ACC + 2] = 9806.65, [MASS] = 20.0, [STIFFNESS] = 6.302, [DAMPING] = 1.598,
                                    [STROKE] = 8000.0, [STOP_STIFFNESS] = 500.0, [STOP_DAMPING] = 500.0};
    memset(d, 0, sizeof *d);
    memcpy(d->real, values, sizeof values);
}

static double axial(const damper *d, double x, double v) /* on the mass, N */
{
    const double *p = d->real, stroke = 1e-3 * p[STROKE];
    double over = fmax(x - stroke, 0.0) + fmin(x + stroke, 0.0);
    double stop = -p[STOP_STIFFNESS] * over - (over * v > 0.0 ? p[STOP_DAMPING] * v : 0.0);
    return 1e3 * (-p[STIFFNESS] * x - p[DAMPING] * v + stop);
}

static double acceleration(const damper *d, double x, double v)
{
    const double *p = d->real, q = DEG * p[RATE + 1], r = DEG * p[RATE + 2];
    return axial(d, x, v) / (1e3 * p[MASS]) - 1e-3 * p[ACC] + (q * q + r * r) * x;
}

static void cross(const double *a, const double *b, double *c)
{
    for (int i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static void outputs(damper *d)
{
    double *p = d->real, r[3] = {d->x}, v[3] = {d->v}, w[3], al[3], euler[3], wr[3], turning[3], coriolis[3];
    for (int i = 0; i < 3; i++) w[i] = DEG * p[RATE + i], al[i] = DEG * p[SPIN + i];
    cross(al, r, euler), cross(w, r, wr), cross(w, wr, turning), cross(w, v, coriolis);
    for (int i = 0; i < 3; i++)
        p[FORCE + i] = -p[MASS] * (1e-3 * p[ACC + i] + euler[i] + turning[i] + 2.0 * coriolis[i]);
    p[FORCE] = -1e-3 * axial(d, d->x, d->v);
    cross(r, p + FORCE, p + MOMENT);
    p[TRAVEL] = 1e3 * d->x, p[SPEED] = 1e3 * d->v, p[HEAT] = d->heat;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    damper *d = c;
    (void)t, (void)keep;
    int n = (int)ceil(h / 2e-3 - 1e-9);
    double s = h / n;
    for (int i = 0; i < n; i++) { /* Runge-Kutta, fourth order */
        double x = d->x, v = d->v, a1 = acceleration(d, x, v), v2 = v + s / 2 * a1;
        double a2 = acceleration(d, x + s / 2 * v, v2), v3 = v + s / 2 * a2;
        double a3 = acceleration(d, x + s / 2 * v2, v3), v4 = v + s * a3;
        double a4 = acceleration(d, x + s * v3, v4);
        d->heat += s * d->real[DAMPING] * v * v;
        d->x += s / 6 * (v + 2 * v2 + 2 * v3 + v4);
        d->v += s / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    outputs(c);
    for (size_t i = 0; i < n; i++) v[i] = ((damper *)c)->real[r[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    for (size_t i = 0; i < n; i++) ((damper *)c)->real[r[i]] = v[i];
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
    damper *d = malloc(sizeof *d);
    if (d) start(d);
    return d;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) { start(c); return fmi2OK; }

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s)
{
    if (!*s) *s = malloc(sizeof(damper));
    memcpy(*s, c, sizeof(damper));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { memcpy(c, s, sizeof(damper)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; free(*s); *s = NULL; return fmi2OK; }

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{
    (void)c, (void)a, (void)b, (void)d, (void)e, (void)f;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

#define NONE(name, ...) fmi2Status name(__VA_ARGS__) { return fmi2Error; }
NONE(fmi2SetDebugLogging, fmi2Component c, fmi2Boolean a, size_t n, const fmi2String s[])
NONE(fmi2GetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
NONE(fmi2SetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
NONE(fmi2GetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
NONE(fmi2SetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
NONE(fmi2GetString, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
NONE(fmi2SetString, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
NONE(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
     const fmi2Real v[])
NONE(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
     fmi2Real v[])
NONE(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference u[], size_t n,
     const fmi2ValueReference k[], size_t m, const fmi2Real d[], fmi2Real v[])
NONE(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
NONE(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
NONE(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
NONE(fmi2CancelStep, fmi2Component c)
NONE(fmi2GetStatus, fmi2Component c, const fmi2StatusKind k, fmi2Status *v)
NONE(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind k, fmi2Real *v)
NONE(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind k, fmi2Integer *v)
NONE(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v)
NONE(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind k, fmi2String *v)
