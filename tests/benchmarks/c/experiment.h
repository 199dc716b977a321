/* What both C programs are told of the rig, the law and the start. SI units. */
struct experiment {
    double h;                /* length of a step [s] */
    double gravity;          /* [m/s^2] */
    double gear[2];          /* motor turns per joint turn, signed */
    double viscous[2];       /* [N m s/rad], motor side */
    double coulomb[2];       /* [N m], motor side */
    double motor_gain[2];    /* [N m/A] */
    double current_limit[2]; /* [A] */
    double resolution[2];    /* pulses per motor turn */
    double gain[2];          /* of the P law, motor torque per pulse [N m] */
    double q[2], qd[2];      /* start [rad, rad/s] */
};
