/* $made
 *
 * What both versions of FMI share.
 */
#include "fmu.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

typedef struct {
    fmu_model model;
    void *environment;
    void *log;
} instance;

static const char *read_reals(instance *self, const uint32_t at[], size_t count, double values[])
{
    const char *said = self->model.phase == INITIALISING ? fmu_begin(&self->model) : NULL;
    for (size_t i = 0; i < count && !said; i++) {
        if (at[i] < REALS)
            values[i] = self->model.real[at[i]];
        else if (at[i] == REALS + WHOLES)
            values[i] = self->model.time;
        else
            said = "a value reference must be that of a real variable";
    }
    return said;
}

static const char *read_wholes(instance *self, const uint32_t at[], size_t count, int32_t values[])
{
    const char *said = self->model.phase == INITIALISING ? fmu_begin(&self->model) : NULL;
    for (size_t i = 0; i < count && !said; i++) {
        if (at[i] < REALS || at[i] >= REALS + WHOLES)
            return "a value reference must be that of a whole number";
        values[i] = self->model.whole[at[i] - REALS];
    }
    return said;
}

static const char *write_reals(instance *self, const uint32_t at[], size_t count, const double values[])
{
    for (size_t i = 0; i < count; i++)
        if (at[i] >= REALS_SET || !isfinite(values[i]))
            return "only inputs and parameters may be set, and to finite values";
    for (size_t i = 0; i < count; i++)
        self->model.real[at[i]] = values[i];
    return NULL;
}

static const char *write_wholes(instance *self, const uint32_t at[], size_t count, const int32_t values[])
{
    for (size_t i = 0; i < count; i++)
        if (at[i] < REALS || at[i] >= REALS + WHOLES_SET)
            return "only inputs may be set";
    for (size_t i = 0; i < count; i++)
        self->model.whole[at[i] - REALS] = values[i];
    return NULL;
}

static const char *entered(instance *self, double time)
{
    if (self->model.phase != CREATED)
        return "initialisation must follow instantiation or reset";
    self->model.phase = INITIALISING;
    self->model.time = time;
    return NULL;
}

static const char *left(instance *self)
{
    if (self->model.phase != INITIALISING)
        return "initialisation must be entered before it is left";
    self->model.phase = STEPPING;
    return fmu_begin(&self->model);
}

static const char *stepped(instance *self, double time, double h)
{
    if (self->model.phase != STEPPING)
        return "a step must follow initialisation";
    const char *said = fmu_step(&self->model, h);
    if (!said)
        self->model.time = time + h;
    return said;
}

static instance *created(const char *token, void *environment, void *log)
{
    instance *self = token && !strcmp(token, FMU_TOKEN) ? calloc(1, sizeof *self) : NULL;
    if (!self)
        return NULL;
    fmu_start(&self->model);
    self->environment = environment;
    self->log = log;
    return self;
}

static const char *saved(const instance *self, void **to)
{
    if (!*to)
        *to = malloc(sizeof self->model);
    if (!*to)
        return "the state does not fit into memory";
    memcpy(*to, &self->model, sizeof self->model);
    return NULL;
}

/* Bytes of a saved state: the token, so that one of another FMU is refused, and the state. */
enum { SERIALISED = sizeof FMU_TOKEN + sizeof(fmu_model) };

static const char *serialised(const void *state, uint8_t bytes[], size_t size)
{
    if (!state || size < SERIALISED)
        return "the buffer must have the size that was asked for";
    memcpy(bytes, FMU_TOKEN, sizeof FMU_TOKEN);
    memcpy(bytes + sizeof FMU_TOKEN, state, sizeof(fmu_model));
    return NULL;
}

static const char *deserialised(const uint8_t bytes[], size_t size, void **to)
{
    if (size < SERIALISED || memcmp(bytes, FMU_TOKEN, sizeof FMU_TOKEN))
        return "these bytes must be a state of this FMU";
    if (!*to)
        *to = malloc(sizeof(fmu_model));
    if (!*to)
        return "the state does not fit into memory";
    memcpy(*to, bytes + sizeof FMU_TOKEN, sizeof(fmu_model));
    return NULL;
}
