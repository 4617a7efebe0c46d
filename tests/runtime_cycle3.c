/* The FMU's C interface of FMI 3.0, for the sanitizers: both interface types, arrays, save, restore, misuse, free. */
#include <stdio.h>
#include <stdlib.h>

#include "fmi3Functions.h"
#include "runtime.h"

static void logger(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m) { (void)e, (void)s, (void)c, (void)m; }

#define REQUIRE(call) do { if ((call) != fmi3OK) { printf("failed: %s\n", #call); return 1; } } while (0)
#define REFUSE(call) do { if ((call) == fmi3OK) { printf("accepted: %s\n", #call); return 1; } } while (0)

/* All real variables, whole arrays at once. */
static int read_all(fmi3Instance c, double *values)
{
    size_t n = 0, elements = 0;
    fmi3ValueReference *vr = malloc((size_t)model.n_variables * sizeof *vr);
    for (int i = 0; i < model.n_variables; i++) {
        if (model.variables[i].kind != REAL || !model.variables[i].size) continue;
        vr[n++] = (fmi3ValueReference)i;
        elements += (size_t)model.variables[i].size;
    }
    const fmi3Status status = fmi3GetFloat64(c, vr, n, values, elements);
    free(vr);
    return status != fmi3OK;
}

static int initialise(fmi3Instance c)
{
    REQUIRE(fmi3EnterInitializationMode(c, fmi3False, 0, 0, fmi3False, 0));
    REQUIRE(fmi3ExitInitializationMode(c));
    return 0;
}

static int step(fmi3Instance c, double *values)
{
    fmi3Boolean event, end, early;
    fmi3Float64 reached;
    fmi3FMUState state = NULL, copy = NULL;
    size_t size;
    if (!c || initialise(c)) return 1;
    for (int i = 0; i < 30; i++) {
        REQUIRE(fmi3DoStep(c, 0.03 * i, 0.03, fmi3True, &event, &end, &early, &reached));
        if (read_all(c, values)) return 1;
    }
    REQUIRE(fmi3GetFMUState(c, &state));
    REQUIRE(fmi3SerializedFMUStateSize(c, state, &size));
    fmi3Byte *bytes = malloc(size);
    REQUIRE(fmi3SerializeFMUState(c, state, bytes, size));
    REQUIRE(fmi3DeserializeFMUState(c, bytes, size, &copy));
    REQUIRE(fmi3SetFMUState(c, copy));
    REQUIRE(fmi3FreeFMUState(c, &state));
    REQUIRE(fmi3FreeFMUState(c, &copy));
    free(bytes);
    const fmi3ValueReference wrong = 1000000;
    REFUSE(fmi3GetFloat64(c, &wrong, 1, values, 1));
    REFUSE(fmi3GetUInt8(c, &wrong, 1, (fmi3UInt8 *)values, 1));
    REQUIRE(fmi3Reset(c));
    if (initialise(c)) return 1;
    REQUIRE(fmi3Terminate(c));
    fmi3FreeInstance(c);
    return 0;
}

static int exchange(fmi3Instance c, double *values)
{
    fmi3Boolean again, end, nominals, states, defined, event;
    fmi3Float64 next;
    size_t n, n_s;
    if (!c || initialise(c)) return 1;
    REQUIRE(fmi3GetNumberOfContinuousStates(c, &n));
    REQUIRE(fmi3GetNumberOfEventIndicators(c, &n_s));
    REQUIRE(fmi3UpdateDiscreteStates(c, &again, &end, &nominals, &states, &defined, &next));
    REQUIRE(fmi3EnterContinuousTimeMode(c));
    for (int i = 1; i <= 30; i++) {
        REQUIRE(fmi3SetTime(c, 0.02 * i));
        REQUIRE(fmi3GetContinuousStates(c, values, n));
        REQUIRE(fmi3SetContinuousStates(c, values, n));
        REQUIRE(fmi3GetContinuousStateDerivatives(c, values, n));
        REQUIRE(fmi3GetNominalsOfContinuousStates(c, values, n));
        REQUIRE(fmi3GetEventIndicators(c, values, n_s));
        REQUIRE(fmi3CompletedIntegratorStep(c, fmi3True, &event, &end));
        REQUIRE(fmi3EnterEventMode(c));
        REQUIRE(fmi3UpdateDiscreteStates(c, &again, &end, &nominals, &states, &defined, &next));
        REQUIRE(fmi3EnterContinuousTimeMode(c));
        if (read_all(c, values)) return 1;
    }
    fmi3FreeInstance(c);
    return 0;
}

int main(void)
{
    double *values = malloc((size_t)model.n_variables * sizeof *values);
    if (fmi3InstantiateCoSimulation("x", "wrong", "", 0, 0, 0, 0, NULL, 0, NULL, logger, NULL)) return 1;
    if (fmi3InstantiateCoSimulation("x", model.guid, "", 0, 0, 1, 0, NULL, 0, NULL, logger, NULL)) return 1;
    if (step(fmi3InstantiateCoSimulation("one", model.guid, "", 0, 0, 0, 0, NULL, 0, NULL, logger, NULL), values)) return 1;
    if (exchange(fmi3InstantiateModelExchange("two", model.guid, "", 0, 0, NULL, logger), values)) return 1;
    free(values);
    printf("cycle complete\n");
    return 0;
}
