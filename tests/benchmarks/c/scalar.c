/* Sums of squared error differences of a two-joint arm in its P loop, one individual after the other.
 *
 * Joint 0 turns about a horizontal axis, joint 1 about an axis parallel to it, further out. With c = cos q1, s = sin q1
 * and the parameters f1..f9 [kg m^2, kg m] of an individual, the equations of motion D(q) qdd + h(q, qd) = tau have
 *
 *     D = | f7 + 2 a   f2 + a |    a = f3 c - f4 s
 *         | f2 + a     f1     |    b = f3 s + f4 c
 *
 *     h0 = -b qd1 (qd1 + 2 qd0) + h1_gravity + g (f8 sin q0 - f9 cos q0)
 *     h1 =  b qd0^2             + h1_gravity,   h1_gravity = g (f6 sin(q0 + q1) - f5 cos(q0 + q1))
 *
 * A step of length h is a midpoint step with one predictor pass for the velocity in h(q, qd); dry friction is an
 * impulse within +-bound, found by three sweeps over the joints that start from the impulse of the last step. SI units.
 *
 * gcc -O3 -march=native -shared -fPIC scalar.c -lm
 */
#include <math.h>

#include "experiment.h"

static const double FAR = 1e6; /* a position [rad] or velocity [rad/s] beyond this has diverged */
static const int SWEEPS = 3;

static double limited(double x, double bound)
{
    return x < -bound ? -bound : x > bound ? bound : x;
}

/* Cost [pulses^2] of one individual, or infinity.
 * sample_reference, measured: (samples, 2), reference and measured error [pulses] at the samples.
 * step_reference: (samples * steps_per_sample, 2), reference [pulses] in the middle of the steps. */
static double cost_of(const double *f, const struct experiment *e, long samples, long steps_per_sample,
                      const double *sample_reference, const double *step_reference, const double *measured)
{
    const double h = e->h, half = 0.5 * h, turn = 8.0 * atan(1.0);
    const double f1 = f[0], f2 = f[1], f3 = f[2], f4 = f[3], f7 = f[6];
    const double g5 = e->gravity * f[4], g6 = e->gravity * f[5], g8 = e->gravity * f[7], g9 = e->gravity * f[8];
    double pulses[2], stiffness[2], limit[2], viscous[2], bound[2];
    for (int i = 0; i < 2; ++i) {
        pulses[i] = e->gear[i] * e->resolution[i] / turn; /* per rad */
        stiffness[i] = e->gear[i] * e->gain[i];           /* joint torque per pulse [N m] */
        limit[i] = fabs(e->gear[i]) * e->motor_gain[i] * e->current_limit[i];
        viscous[i] = e->viscous[i] * e->gear[i] * e->gear[i];
        bound[i] = h * e->coulomb[i] * fabs(e->gear[i]);
    }
    const double D00_constant = f7 + half * viscous[0], D11 = f1 + half * viscous[1], inverse_D11 = 1.0 / D11;

    double q0 = e->q[0], q1 = e->q[1], qd0 = e->qd[0], qd1 = e->qd[1];
    double impulse0 = 0.0, impulse1 = 0.0, score = 0.0;
    int ok = D11 > 0.0;

    for (long sample = 0; sample < samples; ++sample) {
        const double *reference = sample_reference + 2 * sample, *error = measured + 2 * sample;
        const double off0 = error[0] - (reference[0] - trunc(pulses[0] * q0));
        const double off1 = error[1] - (reference[1] - trunc(pulses[1] * q1));
        score += off0 * off0 + off1 * off1;

        for (long step = 0; step < steps_per_sample; ++step) {
            const double *asked = step_reference + 2 * (sample * steps_per_sample + step);
            const double middle0 = q0 + half * qd0, middle1 = q1 + half * qd1;

            const double P0 = stiffness[0] * (asked[0] - trunc(pulses[0] * middle0));
            const double P1 = stiffness[1] * (asked[1] - trunc(pulses[1] * middle1));
            ok &= fabs(P0) < INFINITY && fabs(P1) < INFINITY;

            const double s0 = sin(middle0), c0 = cos(middle0), s1 = sin(middle1), c1 = cos(middle1);
            const double a = f3 * c1 - f4 * s1, b = f3 * s1 + f4 * c1;
            const double gravity1 = g6 * (s0 * c1 + c0 * s1) - g5 * (c0 * c1 - s0 * s1);
            const double gravity0 = gravity1 + g8 * s0 - g9 * c0;

            /* D + h/2 viscous and its inverse */
            const double D00 = D00_constant + 2.0 * a, D01 = f2 + a;
            const double determinant = D00 * D11 - D01 * D01, scale = 1.0 / determinant;
            const double I00 = D11 * scale, I01 = -D01 * scale, I11 = D00 * scale;
            ok &= determinant > 0.0;

            /* velocity without dry friction: predictor, then the step itself */
            const double rest0 = limited(P0, limit[0]) - gravity0 - viscous[0] * qd0;
            const double rest1 = limited(P1, limit[1]) - gravity1 - viscous[1] * qd1;
            double tau0 = rest0 + b * qd1 * (qd1 + 2.0 * qd0), tau1 = rest1 - b * qd0 * qd0;
            const double at0 = qd0 + half * (I00 * tau0 + I01 * tau1), at1 = qd1 + half * (I01 * tau0 + I11 * tau1);
            tau0 = rest0 + b * at1 * (at1 + 2.0 * at0);
            tau1 = rest1 - b * at0 * at0;
            const double free0 = qd0 + h * (I00 * tau0 + I01 * tau1), free1 = qd1 + h * (I01 * tau0 + I11 * tau1);

            /* An impulse on joint i alone stops it where I[i][i] impulse[i] + I[i][j] impulse[j] + free[i] = 0. */
            const double coupling0 = D01 * inverse_D11, coupling1 = D01 / D00;
            const double stop0 = free0 * (determinant * inverse_D11), stop1 = free1 * (determinant / D00);
            impulse1 = limited(impulse1, bound[1]);
            for (int sweep = 0; sweep < SWEEPS; ++sweep) {
                impulse0 = limited(coupling0 * impulse1 - stop0, bound[0]);
                impulse1 = limited(coupling1 * impulse0 - stop1, bound[1]);
            }
            qd0 = free0 + I00 * impulse0 + I01 * impulse1;
            qd1 = free1 + I01 * impulse0 + I11 * impulse1;
            q0 = middle0 + half * qd0;
            q1 = middle1 + half * qd1;
            ok &= fabs(middle0) < FAR && fabs(middle1) < FAR && fabs(qd0) < FAR && fabs(qd1) < FAR;
        }
    }
    return ok && isfinite(score) ? score : INFINITY;
}

void scalar_costs(long population, const double *f, const struct experiment *e, long samples, long steps_per_sample,
                  const double *sample_reference, const double *step_reference, const double *measured, double *cost)
{
    for (long i = 0; i < population; ++i)
        cost[i] = cost_of(f + 9 * i, e, samples, steps_per_sample, sample_reference, step_reference, measured);
}
