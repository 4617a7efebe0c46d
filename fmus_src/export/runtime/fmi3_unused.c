/* Functions of FMI 3.0 for what these FMUs do not have: binaries, clocks, structural parameters, numeric types beside
 * Float64 and Int32, event mode in co-simulation, scheduled execution, adjoint derivatives. */
#include "fmi3Functions.h"
#include "instance.h"

static fmi3Status unused_status(int failed) { return failed ? fmi3Error : fmi3OK; }

static fmi3Status not_provided(instance *m, const char *function)
{
    return unused_status(!m || report(m, "%s: not provided", function));
}

static fmi3Status none_of(instance *m, const char *function, size_t n)
{
    return unused_status(!m || (n && report(m, "%s: this FMU has no variable of that type", function)));
}

#define UNUSED_TYPE(TYPE)                                                                                             \
    fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE value[], size_t k)   \
    {                                                                                                                 \
        (void)vr, (void)value, (void)k;                                                                               \
        return none_of(c, "fmi3Get" #TYPE, n);                                                                        \
    }                                                                                                                 \
    fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##TYPE value[],       \
                             size_t k)                                                                                \
    {                                                                                                                 \
        (void)vr, (void)value, (void)k;                                                                               \
        return none_of(c, "fmi3Set" #TYPE, n);                                                                        \
    }

UNUSED_TYPE(Float32)
UNUSED_TYPE(Int8)
UNUSED_TYPE(UInt8)
UNUSED_TYPE(Int16)
UNUSED_TYPE(UInt16)
UNUSED_TYPE(UInt32)
UNUSED_TYPE(Int64)
UNUSED_TYPE(UInt64)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary value[],
                         size_t n_values)
{
    (void)vr, (void)sizes, (void)value, (void)n_values;
    return none_of(c, "fmi3GetBinary", n);
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary value[], size_t n_values)
{
    (void)vr, (void)sizes, (void)value, (void)n_values;
    return none_of(c, "fmi3SetBinary", n);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n)
{
    (void)vr, (void)n;
    return not_provided(c, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t of_independents[],
                                       fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent, (void)elements, (void)independents, (void)of_independents, (void)kinds, (void)n;
    return not_provided(c, "fmi3GetVariableDependencies");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference sought[], size_t n_sought,
                                    const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
                                    size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    (void)sought, (void)n_sought, (void)known, (void)n_known, (void)seed, (void)n_seed, (void)sensitivity;
    (void)n_sensitivity;
    return not_provided(c, "fmi3GetAdjointDerivative");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (logger) logger(environment, fmi3Error, "logStatusError", "scheduled execution is not provided");
    return NULL;
}

fmi3Status fmi3EnterStepMode(fmi3Instance c) { return not_provided(c, "fmi3EnterStepMode"); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return not_provided(c, "fmi3EnterConfigurationMode"); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return not_provided(c, "fmi3ExitConfigurationMode"); }

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
                                    fmi3Float64 value[], size_t n_values)
{
    (void)vr, (void)n, (void)orders, (void)value, (void)n_values;
    return not_provided(c, "fmi3GetOutputDerivatives");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return not_provided(c, "fmi3ActivateModelPartition");
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock value[])
{
    (void)vr, (void)value;
    return none_of(c, "fmi3GetClock", n);
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock value[])
{
    (void)vr, (void)value;
    return none_of(c, "fmi3SetClock", n);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[])
{
    (void)vr, (void)intervals, (void)qualifiers;
    return none_of(c, "fmi3GetIntervalDecimal", n);
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)vr, (void)counters, (void)resolutions, (void)qualifiers;
    return none_of(c, "fmi3GetIntervalFraction", n);
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
{
    (void)vr, (void)shifts;
    return none_of(c, "fmi3GetShiftDecimal", n);
}

fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[])
{
    (void)vr, (void)counters, (void)resolutions;
    return none_of(c, "fmi3GetShiftFraction", n);
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                  const fmi3Float64 intervals[])
{
    (void)vr, (void)intervals;
    return none_of(c, "fmi3SetIntervalDecimal", n);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[])
{
    (void)vr, (void)counters, (void)resolutions;
    return none_of(c, "fmi3SetIntervalFraction", n);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[])
{
    (void)vr, (void)shifts;
    return none_of(c, "fmi3SetShiftDecimal", n);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[])
{
    (void)vr, (void)counters, (void)resolutions;
    return none_of(c, "fmi3SetShiftFraction", n);
}
