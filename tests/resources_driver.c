/* Has an FMU of wind open a file, once for each folder of resources that the importer may name:
 *   driver LIBRARY FMI GUID TEXT_REFERENCE TEXT REFERENCE RESOURCES...
 * Prints the number at the reference, or why there is none, a line each. */
#include "loading.h"

static void logger3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m)
{
    (void)e, (void)s, (void)c;
    printf("%s\n", m);
}

static void run2(const char *guid, unsigned at, const char *text, unsigned read, const char *resources)
{
    fmi2CallbackFunctions callbacks = {logger2, calloc, free, NULL, NULL};
    double value;
    fmi2Component c = F2(Instantiate)("one", fmi2CoSimulation, guid, resources, &callbacks, 0, 0);
    if (!c) return;
    F2(SetupExperiment)(c, 0, 0.0, 0.0, 0, 0.0);
    F2(SetString)(c, &at, 1, &text);
    F2(EnterInitializationMode)(c);
    if (!F2(ExitInitializationMode)(c) && !F2(GetReal)(c, &read, 1, &value)) printf("%.17g\n", value);
    F2(FreeInstance)(c);
}

static void run3(const char *token, unsigned at, const char *text, unsigned read, const char *resources)
{
    double value;
    fmi3Instance c = F3(InstantiateCoSimulation)("one", token, resources, 0, 0, 0, 0, NULL, 0, NULL, logger3, NULL);
    if (!c) return;
    F3(SetString)(c, &at, 1, &text, 1);
    F3(EnterInitializationMode)(c, 0, 0.0, 0.0, 0, 0.0);
    if (!F3(ExitInitializationMode)(c) && !F3(GetFloat64)(c, &read, 1, &value, 1)) printf("%.17g\n", value);
    F3(FreeInstance)(c);
}

int main(int count, char **a)
{
    if (count < 8 || !load(a[1])) return printf("cannot load %s\n", count > 1 ? a[1] : "nothing"), 1;
    const unsigned at = (unsigned)atoi(a[4]), read = (unsigned)atoi(a[6]);
    for (int i = 7; i < count; i++) (a[2][0] == '2' ? run2 : run3)(a[3], at, a[5], read, a[i]);
    return 0;
}
