/* The same, of measured counts as numbers: NAN for one that is missing, which the guards bridge, or stop for. */
int ${name}_sample(${name}_state *self, const double measured[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n]$clock, $type $output[$size]);

/* 0 while it runs, otherwise why it stops the arm, until ${name}_init. */
int ${name}_stopped(const ${name}_state *self);

/* The last cause that was bridged or stopped, its joint from 0, and the number of the call. */
int ${name}_event(const ${name}_state *self, int *joint, long *call);

/* 1 where the mechanical brakes should hold the arm: the law does so no longer. */
int ${name}_brake(const ${name}_state *self);

