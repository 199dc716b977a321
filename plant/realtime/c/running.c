/* $made */
#include "$name.h"

#include <math.h>

#define N $n
#define SIZE $size

/* -- places in the memory, and thresholds -- */
$constants
$helpers
/* -- of the law and the rig -- */
$pieces
/* -- guards and stop -- */
$logic
/* -- the controller -- */
void ${name}_init(${name}_state *self, const int32_t pulses[N])
{
    static const double initial[SIZE] = $initial;
    for (int i = 0; i < SIZE; i++)
        self->memory[i] = initial[i];
    for (int i = 0; i < N; i++)
        self->memory[SCALARS + COUNTS * N + i] = (double)pulses[i];
}

int ${name}_step(${name}_state *self, const int32_t pulses[N], const double q_r[N], const double qd_r[N],
    const double qdd_r[N]$clock, $type given[N])
{
    double counts[N];
    for (int i = 0; i < N; i++)
        counts[i] = (double)pulses[i];
    return ${name}_sample(self, counts, q_r, qd_r, qdd_r$passed, given);
}

int ${name}_sample(${name}_state *self, const double measured[N], const double q_r[N], const double qd_r[N],
    const double qdd_r[N]$clock, $type given[N])
{
    double torque[N] = {0.0};
    const int refusal = (int)${prefix}step(measured, q_r, qd_r, qdd_r, $at, self->memory, torque);
    if (refusal == DONE)
        ${prefix}give(self->memory, torque, given);
    return refusal;
}

int ${name}_stopped(const ${name}_state *self)
{
    return (int)self->memory[CAUSE];
}

int ${name}_event(const ${name}_state *self, int *joint, long *call)
{
    *joint = (int)self->memory[EVENT_JOINT];
    *call = (long)self->memory[EVENT_CALL];
    return (int)self->memory[EVENT];
}

int ${name}_brake(const ${name}_state *self)
{
    const double released = self->memory[RELEASED];
    return released == LATCHED || (released != HOLDING && self->memory[SINCE] >= $ramp * self->memory[DURATION]);
}
