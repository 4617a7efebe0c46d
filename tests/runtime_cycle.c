/* Every function of the FMU's C interface once, for the sanitizers: two instances, save, restore, reset, misuse, free. */
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"
#include "runtime.h"

static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e, (void)name, (void)s, (void)c, (void)m;
}

#define REQUIRE(call) do { if ((call) != fmi2OK) { printf("failed: %s\n", #call); return 1; } } while (0)
#define REFUSE(call) do { if ((call) == fmi2OK) { printf("accepted: %s\n", #call); return 1; } } while (0)

static int run(fmi2Component c, int n_read, const fmi2ValueReference *read, double *values)
{
    for (int i = 0; i < 50; i++) {
        fmi2ValueReference input = (fmi2ValueReference)(model.n_p + model.n_k);
        fmi2Real u = 0.01 * i, slope = 0.3;
        fmi2Integer order = 1;
        if (model.n_u > 0) {
            REQUIRE(fmi2SetReal(c, &input, 1, &u));
            REQUIRE(fmi2SetRealInputDerivatives(c, &input, 1, &order, &slope));
        }
        REQUIRE(fmi2DoStep(c, 0.03 * i, 0.03, fmi2True));
        REQUIRE(fmi2GetReal(c, read, n_read, values));
    }
    return 0;
}

static int initialise(fmi2Component c)
{
    REQUIRE(fmi2SetupExperiment(c, fmi2False, 0, 0, fmi2False, 0));
    REQUIRE(fmi2EnterInitializationMode(c));
    REQUIRE(fmi2ExitInitializationMode(c));
    return 0;
}

static int exchange(const fmi2CallbackFunctions *callbacks)
{
    fmi2Component c = fmi2Instantiate("three", fmi2ModelExchange, model.guid, "", callbacks, 0, 0);
    const size_t n = (size_t)model.n_x, n_s = (size_t)model.n_switches;
    double *x = malloc((2 * n + n_s + 1) * sizeof *x), *dx = x + n, *signs = dx + n, seed = 1.0, derivative;
    fmi2ValueReference state = (fmi2ValueReference)(model.n_variables - 1 - (int)(2 * n + n_s) - model.n_z);
    fmi2ValueReference rate = (fmi2ValueReference)(model.n_variables - (int)(n + n_s));
    fmi2EventInfo info;
    fmi2Boolean event, end;
    fmi2FMUstate saved = NULL;
    if (!c || initialise(c)) return 1;
    REQUIRE(fmi2NewDiscreteStates(c, &info));
    REQUIRE(fmi2EnterContinuousTimeMode(c));
    for (int i = 1; i <= 50; i++) {
        REQUIRE(fmi2GetContinuousStates(c, x, n));
        REQUIRE(fmi2GetDerivatives(c, dx, n));
        for (size_t k = 0; k < n; k++) x[k] += 0.02 * dx[k];
        REQUIRE(fmi2SetTime(c, 0.02 * i));
        REQUIRE(fmi2SetContinuousStates(c, x, n));
        REQUIRE(fmi2GetEventIndicators(c, signs, n_s));
        REQUIRE(fmi2CompletedIntegratorStep(c, 1, &event, &end));
        if (i == 25) REQUIRE(fmi2GetFMUstate(c, &saved));
        if (!event && !(info.nextEventTimeDefined && 0.02 * i > info.nextEventTime - 1e-9)) continue;
        REQUIRE(fmi2EnterEventMode(c));
        REQUIRE(fmi2NewDiscreteStates(c, &info));
        REQUIRE(fmi2EnterContinuousTimeMode(c));
    }
    REQUIRE(fmi2SetFMUstate(c, saved));
    REQUIRE(fmi2GetDirectionalDerivative(c, &rate, 1, &state, 1, &seed, &derivative));
    REQUIRE(fmi2FreeFMUstate(c, &saved));
    REFUSE(fmi2DoStep(c, 0.5, 0.1, 1));
    fmi2FreeInstance(c);
    free(x);
    return 0;
}

int main(void)
{
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component one = fmi2Instantiate("one", fmi2CoSimulation, model.guid, "", &callbacks, 0, 0);
    fmi2Component two = fmi2Instantiate("two", fmi2CoSimulation, model.guid, "", &callbacks, 0, 1);
    if (!one || !two || fmi2Instantiate("x", fmi2CoSimulation, "wrong", "", &callbacks, 0, 0)) return 1;

    int n = model.n_y, first = model.n_p + model.n_k + model.n_u;
    fmi2ValueReference *read = malloc(n * sizeof *read);
    double *values = malloc(n * sizeof *values), derivative, seed = 1.0;
    for (int i = 0; i < n; i++) read[i] = (fmi2ValueReference)(first + i);
    if (initialise(one) || initialise(two) || run(one, n, read, values) || run(two, n, read, values)) return 1;

    fmi2FMUstate state = NULL, copy = NULL;
    size_t size;
    REQUIRE(fmi2GetFMUstate(one, &state));
    REQUIRE(fmi2SerializedFMUstateSize(one, state, &size));
    fmi2Byte *bytes = malloc(size);
    REQUIRE(fmi2SerializeFMUstate(one, state, bytes, size));
    REQUIRE(fmi2DeSerializeFMUstate(one, bytes, size, &copy));
    REFUSE(fmi2DeSerializeFMUstate(one, bytes, size - 1, &copy));
    REQUIRE(fmi2SetFMUstate(one, copy));
    fmi2ValueReference input = (fmi2ValueReference)(model.n_p + model.n_k);
    REQUIRE(fmi2GetDirectionalDerivative(one, read, 1, &input, model.n_u > 0, &seed, &derivative));
    REQUIRE(fmi2FreeFMUstate(one, &state));
    REQUIRE(fmi2FreeFMUstate(one, &copy));

    fmi2ValueReference wrong = 1000000;
    REFUSE(fmi2GetReal(one, &wrong, 1, values));
    REQUIRE(fmi2Reset(one));
    if (initialise(one) || run(one, n, read, values)) return 1;
    REQUIRE(fmi2Terminate(one));
    fmi2FreeInstance(one);
    fmi2FreeInstance(two);
    if (exchange(&callbacks)) return 1;
    free(bytes), free(read), free(values);
    printf("cycle complete\n");
    return 0;
}
