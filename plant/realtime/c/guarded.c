
int ${name}_sample(${name}_state *self, const double measured[N], const double q_r[N], const double qd_r[N],
    const double qdd_r[N]$clock, $type given[$size])
{
    double torque[N] = {0.0};
    const int refusal = (int)${prefix}sample(measured, q_r, qd_r, qdd_r, $at, self, torque);
    if (refusal == DONE)
        ${prefix}give(self, torque, given);
    return refusal;
}

int ${name}_stopped(const ${name}_state *self)
{
    return (int)self->run.cause;
}

int ${name}_event(const ${name}_state *self, int *joint, long *call)
{
    *joint = (int)self->run.event_joint;
    *call = (long)self->run.event_call;
    return (int)self->run.event;
}

int ${name}_brake(const ${name}_state *self)
{
    const double released = self->run.released;
    return released == LATCHED || (released != HOLDING && self->run.since >= $ramp * self->run.duration);
}
