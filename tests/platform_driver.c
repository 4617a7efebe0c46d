/* Loads an FMU's library as an importer does and prints a run of its co-simulation:
 *   driver LIBRARY FMI GUID PARAMETER INPUT SCALARS REFERENCE...
 * The parameter is set to 8.3, the input (x of an acceleration) to a saw-tooth; the references' SCALARS numbers are printed after each step. */
#include "loading.h"
#define REQUIRE(call) do { if ((call) != 0) { printf("failed: %s\n", #call); return 1; } } while (0)

static const double step = 0.03;

static void print(const double *values, int n)
{
    for (int i = 0; i < n; i++) printf("%.17g%c", values[i], i + 1 < n ? ' ' : '\n');
}

static double push(int i) { return (i % 20 < 10 ? 9.0 : -9.0) * (0.1 * (i % 10)); }

static int run2(const char *guid, unsigned parameter, unsigned input, int n, const unsigned *read)
{
    fmi2CallbackFunctions callbacks = {logger2, calloc, free, NULL, NULL};
    double value = 8.3, values[64];
    fmi2Component c = F2(Instantiate)("one", fmi2CoSimulation, guid, "", &callbacks, 0, 0);
    if (!c) return 1;
    REQUIRE(F2(SetupExperiment)(c, 0, 0.0, 0.0, 0, 0.0));
    REQUIRE(F2(SetReal)(c, &parameter, 1, &value));
    REQUIRE(F2(EnterInitializationMode)(c));
    REQUIRE(F2(ExitInitializationMode)(c));
    for (int i = 0; i < 100; i++) {
        value = push(i);
        REQUIRE(F2(SetReal)(c, &input, 1, &value));
        REQUIRE(F2(DoStep)(c, step * i, step, 1));
        REQUIRE(F2(GetReal)(c, read, (size_t)n, values));
        print(values, n);
    }
    REQUIRE(F2(Terminate)(c));
    F2(FreeInstance)(c);
    return 0;
}

static int run3(const char *token, unsigned parameter, unsigned input, int n, const unsigned *read, int n_read)
{
    double value[3] = {8.3, 0.0, 9.80665}, values[64], reached;
    bool event, end, early;
    fmi3Instance c = F3(InstantiateCoSimulation)("one", token, "", 0, 0, 0, 0, NULL, 0, NULL, NULL, NULL);
    if (!c) return 1;
    REQUIRE(F3(SetFloat64)(c, &parameter, 1, value, 1));
    REQUIRE(F3(EnterInitializationMode)(c, 0, 0.0, 0.0, 0, 0.0));
    REQUIRE(F3(ExitInitializationMode)(c));
    for (int i = 0; i < 100; i++) {
        value[0] = push(i);
        REQUIRE(F3(SetFloat64)(c, &input, 1, value, 3));
        REQUIRE(F3(DoStep)(c, step * i, step, 1, &event, &end, &early, &reached));
        REQUIRE(F3(GetFloat64)(c, read, (size_t)n_read, values, (size_t)n));
        print(values, n);
    }
    REQUIRE(F3(Terminate)(c));
    F3(FreeInstance)(c);
    return 0;
}

int main(int count, char **arguments)
{
    unsigned read[64];
    if (count < 8 || !load(arguments[1])) return printf("cannot load %s\n", count > 1 ? arguments[1] : "nothing"), 1;
    for (int i = 7; i < count; i++) read[i - 7] = (unsigned)atoi(arguments[i]);
    const unsigned parameter = (unsigned)atoi(arguments[4]), input = (unsigned)atoi(arguments[5]);
    const int n = atoi(arguments[6]);
    return arguments[2][0] == '2' ? run2(arguments[3], parameter, input, n, read)
                                  : run3(arguments[3], parameter, input, n, read, count - 7);
}
