/* $made
 *
 * FMI 3.0, co-simulation. The types and functions are those of the standard (fmi-standard.org, 3.0.1).
 */
#include "common.c"

#ifndef fmi3PlatformTypes_h
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
#endif
#ifndef fmi3FunctionTypes_h
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean,
    fmi3Boolean, fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)();
typedef void (*fmi3UnlockPreemptionCallback)();
#endif

#pragma GCC diagnostic ignored "-Wunused-parameter" /* of what there is none of */

static fmi3Status status(instance *self, const char *said)
{
    const fmi3LogMessageCallback *log = self->log;
    if (said && *log)
        (*log)(self->environment, fmi3Error, "logStatusError", said);
    return said ? fmi3Error : fmi3OK;
}

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference needed[],
    size_t count, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    fmi3LogMessageCallback *const kept = malloc(sizeof log);
    instance *const self = kept && !count ? created(token, environment, kept) : NULL;
    if (self)
        *kept = log;
    else
        free(kept);
    return self;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    return NULL;
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

EXPORT void fmi3FreeInstance(fmi3Instance self)
{
    if (self)
        free(((instance *)self)->log);
    free(self);
}

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance self, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    return fmi3OK;
}

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance self, fmi3Boolean limited, fmi3Float64 tolerance,
    fmi3Float64 start, fmi3Boolean ends, fmi3Float64 stop)
{
    return status(self, entered(self, start));
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance self)
{
    return status(self, left(self));
}

EXPORT fmi3Status fmi3Terminate(fmi3Instance self)
{
    ((instance *)self)->model.phase = TERMINATED;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(fmi3Instance self)
{
    fmu_start(&((instance *)self)->model);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance self, const fmi3ValueReference at[], size_t count, fmi3Float64 values[],
    size_t size)
{
    return status(self, read_reals(self, at, count, values));
}

EXPORT fmi3Status fmi3GetInt32(fmi3Instance self, const fmi3ValueReference at[], size_t count, fmi3Int32 values[],
    size_t size)
{
    return status(self, read_wholes(self, at, count, values));
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance self, const fmi3ValueReference at[], size_t count,
    const fmi3Float64 values[], size_t size)
{
    return status(self, write_reals(self, at, count, values));
}

EXPORT fmi3Status fmi3SetInt32(fmi3Instance self, const fmi3ValueReference at[], size_t count,
    const fmi3Int32 values[], size_t size)
{
    return status(self, write_wholes(self, at, count, values));
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance self, fmi3FMUState *state)
{
    return status(self, saved(self, state));
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance self, fmi3FMUState state)
{
    if (state)
        memcpy(&((instance *)self)->model, state, sizeof(fmu_model));
    return status(self, state ? NULL : "a state must have been saved");
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance self, fmi3FMUState *state)
{
    free(*state);
    *state = NULL;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance self, fmi3FMUState state, size_t *size)
{
    *size = SERIALISED;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance self, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    return status(self, serialised(state, bytes, size));
}

EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance self, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    return status(self, deserialised(bytes, size, state));
}

EXPORT fmi3Status fmi3DoStep(fmi3Instance self, fmi3Float64 time, fmi3Float64 h, fmi3Boolean final,
    fmi3Boolean *events, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    const char *said = stepped(self, time, h);
    *events = *terminate = *early = false;
    *reached = ((instance *)self)->model.time;
    return status(self, said);
}

/* -- what there is none of -- */
static const char NONE[] = "this FMU has no such variable, mode or derivative";

#define ABSENT_VARIABLES(kind) \
    EXPORT fmi3Status fmi3Get##kind( \
        fmi3Instance self, const fmi3ValueReference at[], size_t count, fmi3##kind to[], size_t size) \
    { \
        return status(self, count ? NONE : NULL); \
    } \
    EXPORT fmi3Status fmi3Set##kind( \
        fmi3Instance self, const fmi3ValueReference at[], size_t count, const fmi3##kind from[], size_t size) \
    { \
        return status(self, count ? NONE : NULL); \
    }
ABSENT_VARIABLES(Float32)
ABSENT_VARIABLES(Int8)
ABSENT_VARIABLES(UInt8)
ABSENT_VARIABLES(Int16)
ABSENT_VARIABLES(UInt16)
ABSENT_VARIABLES(UInt32)
ABSENT_VARIABLES(Int64)
ABSENT_VARIABLES(UInt64)
ABSENT_VARIABLES(Boolean)
ABSENT_VARIABLES(String)

#define ABSENT(name, ...) \
    EXPORT fmi3Status fmi3##name(fmi3Instance self, __VA_ARGS__) \
    { \
        return status(self, NONE); \
    }
#define ABSENT_MODE(name) \
    EXPORT fmi3Status fmi3##name(fmi3Instance self) \
    { \
        return status(self, NONE); \
    }
#define AT const fmi3ValueReference at[], size_t count
#define DERIVATIVE const fmi3ValueReference unknown[], size_t unknowns, const fmi3ValueReference known[], \
    size_t knowns, const fmi3Float64 seed[], size_t seeds, fmi3Float64 to[], size_t size
ABSENT(GetBinary, AT, size_t sizes[], fmi3Binary to[], size_t size)
ABSENT(SetBinary, AT, const size_t sizes[], const fmi3Binary from[], size_t size)
ABSENT(GetClock, AT, fmi3Clock to[])
ABSENT(SetClock, AT, const fmi3Clock from[])
ABSENT(GetNumberOfVariableDependencies, fmi3ValueReference of, size_t *count)
ABSENT(GetVariableDependencies, fmi3ValueReference of, size_t dependent[], fmi3ValueReference on[], size_t element[],
    fmi3DependencyKind kinds[], size_t count)
ABSENT(GetDirectionalDerivative, DERIVATIVE)
ABSENT(GetAdjointDerivative, DERIVATIVE)
ABSENT(GetOutputDerivatives, AT, const fmi3Int32 orders[], fmi3Float64 to[], size_t size)
ABSENT(GetIntervalDecimal, AT, fmi3Float64 to[], fmi3IntervalQualifier qualifiers[])
ABSENT(GetIntervalFraction, AT, fmi3UInt64 to[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
ABSENT(GetShiftDecimal, AT, fmi3Float64 to[])
ABSENT(GetShiftFraction, AT, fmi3UInt64 to[], fmi3UInt64 resolutions[])
ABSENT(SetIntervalDecimal, AT, const fmi3Float64 from[])
ABSENT(SetIntervalFraction, AT, const fmi3UInt64 from[], const fmi3UInt64 resolutions[])
ABSENT(SetShiftDecimal, AT, const fmi3Float64 from[])
ABSENT(SetShiftFraction, AT, const fmi3UInt64 from[], const fmi3UInt64 resolutions[])
ABSENT(UpdateDiscreteStates, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *states,
    fmi3Boolean *planned, fmi3Float64 *next)
ABSENT(CompletedIntegratorStep, fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *terminate)
ABSENT(SetTime, fmi3Float64 time)
ABSENT(SetContinuousStates, const fmi3Float64 from[], size_t size)
ABSENT(GetContinuousStateDerivatives, fmi3Float64 to[], size_t size)
ABSENT(GetEventIndicators, fmi3Float64 to[], size_t size)
ABSENT(GetContinuousStates, fmi3Float64 to[], size_t size)
ABSENT(GetNominalsOfContinuousStates, fmi3Float64 to[], size_t size)
ABSENT(GetNumberOfEventIndicators, size_t *count)
ABSENT(GetNumberOfContinuousStates, size_t *count)
ABSENT(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
ABSENT_MODE(EnterEventMode)
ABSENT_MODE(EnterConfigurationMode)
ABSENT_MODE(ExitConfigurationMode)
ABSENT_MODE(EvaluateDiscreteStates)
ABSENT_MODE(EnterContinuousTimeMode)
ABSENT_MODE(EnterStepMode)
