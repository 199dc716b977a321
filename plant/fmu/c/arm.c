/* $made
 *
 * A geared arm, $steps midpoint steps per period of its rig: a step holds the torques of its beginning.
 */
#include "fmu.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

/* $listed */
static const double numbers[] = $numbers;

enum { Q_START = JOINTS, QD_START = 2 * JOINTS, F = 3 * JOINTS, SEEN = REALS_SET };

$helpers/* The state of an arm that starts there; elastic gears carry its weight. */
static void settled(const double *q, const double *qd, const double *f, double *state)
{
    (void)qd, (void)f;
$settled
}

/* One midpoint step. */
static void moved(double *state, const double *torque, const double *f)
{
    (void)f;
$moved
}

/* Position, velocity and counts; whether the motion is bounded. */
static int observed(const double *state, double *seen, double *counts)
{
$observed
}

void fmu_start(fmu_model *self)
{
    static const fmu_model start = {.real = $start};
    *self = start;
}

static const char *shown(fmu_model *self)
{
    double counts[JOINTS];
    if (!observed(self->state.state, self->real + SEEN, counts))
        return "the arm must stay bounded; it does not under this torque";
    for (int i = 0; i < JOINTS; i++) {
        if (!(fabs(counts[i]) < 2147483647.0))
            return "counts must fit into 32 bits; the joint has turned too far";
        self->whole[i] = (int32_t)counts[i];
    }
    return NULL;
}

const char *fmu_begin(fmu_model *self)
{
    settled(self->real + Q_START, self->real + QD_START, self->real + F, self->state.state);
    return shown(self);
}

const char *fmu_step(fmu_model *self, double h)
{
    const double count = floor(h / $h + 0.5);
    if (!(count >= 1.0 && fabs(count * $h - h) <= 1e-6 * h))
        return "a step must be a whole multiple of the sub-step, $h s";
    const ${name}_state before = self->state;
    for (double done = 0.0; done < count; done++)
        moved(self->state.state, self->real, self->real + F);
    const char *said = shown(self);
    if (said) {
        self->state = before;
        shown(self);
    }
    return said;
}
