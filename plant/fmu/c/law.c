/* $made
 *
 * A controller with its guards: a step takes the inputs of its beginning, and gives the torque to be held along it.
 */
#include "fmu.h"

#include <math.h>
#include <stddef.h>

void fmu_start(fmu_model *self)
{
    static const fmu_model start = {.real = $start};
    *self = start;
}

const char *fmu_begin(fmu_model *self)
{
    ${name}_init(&self->state, self->whole);
    return NULL;
}

const char *fmu_step(fmu_model *self, double h)
{
    if (!(fabs(h - $period) <= 1e-6 * $period))
        return "a step must be one period of the law, $period s";
    double *const in = self->real;
    if (${name}_step(&self->state, self->whole, in, in + JOINTS, in + 2 * JOINTS, NAN, in + 3 * JOINTS))
        return "the law must give finite torques; it does not for these inputs";
    self->whole[JOINTS] = ${name}_stopped(&self->state);
    self->whole[JOINTS + 1] = ${name}_brake(&self->state);
    return NULL;
}
