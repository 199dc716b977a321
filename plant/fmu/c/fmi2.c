/* $made
 *
 * FMI 2.0, co-simulation. The types and functions are those of the standard (fmi-standard.org, 2.0.4).
 */
#include "common.c"

#ifndef fmi2TypesPlatform_h
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Char, fmi2Byte;
typedef const fmi2Char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#endif

static fmi2Status status(instance *self, const char *said)
{
    const fmi2CallbackFunctions *calls = self->log;
    if (said && calls && calls->logger)
        calls->logger(self->environment, "$name", fmi2Error, "logStatusError", "%s", said);
    return said ? fmi2Error : fmi2OK;
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
    const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    void *const environment = calls ? calls->componentEnvironment : NULL;
    return type == fmi2CoSimulation ? created(token, environment, (void *)calls) : NULL;
}

EXPORT void fmi2FreeInstance(fmi2Component self)
{
    free(self);
}

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component self, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)self, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component self, fmi2Boolean limited, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean ends, fmi2Real stop)
{
    (void)limited, (void)tolerance, (void)ends, (void)stop;
    ((instance *)self)->model.time = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component self)
{
    return status(self, entered(self, ((instance *)self)->model.time));
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component self)
{
    return status(self, left(self));
}

EXPORT fmi2Status fmi2Terminate(fmi2Component self)
{
    ((instance *)self)->model.phase = TERMINATED;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component self)
{
    fmu_start(&((instance *)self)->model);
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component self, const fmi2ValueReference at[], size_t count, fmi2Real values[])
{
    return status(self, read_reals(self, at, count, values));
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component self, const fmi2ValueReference at[], size_t count, fmi2Integer values[])
{
    return status(self, read_wholes(self, at, count, values));
}

EXPORT fmi2Status fmi2SetReal(fmi2Component self, const fmi2ValueReference at[], size_t count, const fmi2Real values[])
{
    return status(self, write_reals(self, at, count, values));
}

EXPORT fmi2Status fmi2SetInteger(fmi2Component self, const fmi2ValueReference at[], size_t count,
    const fmi2Integer values[])
{
    return status(self, write_wholes(self, at, count, values));
}

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component self, fmi2FMUstate *state)
{
    return status(self, saved(self, state));
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component self, fmi2FMUstate state)
{
    if (state)
        memcpy(&((instance *)self)->model, state, sizeof(fmu_model));
    return status(self, state ? NULL : "a state must have been saved");
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component self, fmi2FMUstate *state)
{
    (void)self;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component self, fmi2FMUstate state, size_t *size)
{
    (void)self, (void)state;
    *size = SERIALISED;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component self, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return status(self, serialised(state, (uint8_t *)bytes, size));
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component self, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return status(self, deserialised((const uint8_t *)bytes, size, state));
}

EXPORT fmi2Status fmi2DoStep(fmi2Component self, fmi2Real time, fmi2Real h, fmi2Boolean final)
{
    (void)final;
    return status(self, stepped(self, time, h));
}

/* -- what there is none of -- */
static const char NONE[] = "this FMU has no such variable, derivative or pending step";

EXPORT fmi2Status fmi2CancelStep(fmi2Component self)
{
    return status(self, NONE);
}

#define ABSENT_VARIABLES(kind) \
    EXPORT fmi2Status fmi2Get##kind(fmi2Component self, const fmi2ValueReference at[], size_t count, fmi2##kind to[]) \
    { \
        (void)at, (void)to; \
        return status(self, count ? NONE : NULL); \
    } \
    EXPORT fmi2Status fmi2Set##kind( \
        fmi2Component self, const fmi2ValueReference at[], size_t count, const fmi2##kind from[]) \
    { \
        (void)at, (void)from; \
        return status(self, count ? NONE : NULL); \
    }
ABSENT_VARIABLES(Boolean)
ABSENT_VARIABLES(String)

#define ABSENT_STATUS(kind, type) \
    EXPORT fmi2Status fmi2Get##kind##Status(fmi2Component self, const fmi2StatusKind of, type *to) \
    { \
        (void)self, (void)of, (void)to; \
        return fmi2Discard; \
    }
ABSENT_STATUS(, fmi2Status)
ABSENT_STATUS(Integer, fmi2Integer)
ABSENT_STATUS(Boolean, fmi2Boolean)
ABSENT_STATUS(String, fmi2String)

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component self, const fmi2StatusKind of, fmi2Real *to)
{
    if (of == fmi2LastSuccessfulTime)
        *to = ((instance *)self)->model.time;
    return of == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component self, const fmi2ValueReference at[], size_t count,
    const fmi2Integer order[], const fmi2Real from[])
{
    (void)at, (void)order, (void)from;
    return status(self, count ? NONE : NULL);
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component self, const fmi2ValueReference at[], size_t count,
    const fmi2Integer order[], fmi2Real to[])
{
    (void)at, (void)order, (void)to;
    return status(self, count ? NONE : NULL);
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component self, const fmi2ValueReference unknown[], size_t unknowns,
    const fmi2ValueReference known[], size_t knowns, const fmi2Real by[], fmi2Real to[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)by, (void)to;
    return status(self, NONE);
}
