/* $made
 *
$about
 * $precision
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_GUARDED 1 /* the running controller: it reads a clock, and stops the arm */
#define ${NAME}_JOINTS $n
#define ${NAME}_PERIOD $period /* [s], from one call of ${name}_step to the next */

/* Why it stopped the arm, or what it bridged last. */
enum {
$causes};

$structs
/* To be called first, and after a stop: encoder counts now. */
void ${name}_init(${name}_state *self, const int32_t pulses[$n]);

/* One sample: what to apply until the next call.
 *
 * pulses            encoder counts of the motors, read now
 * q_r, qd_r, qdd_r  reference for now, joint side [rad, rad/s, rad/s^2]
 * now               time of a steady clock [s], NAN without one; in single precision there is none
 * $output            $meaning
 *
 * Gives 0. A call that nothing can answer gives more, and changes neither *self nor $output: without guards NaN or an
 * infinity, with them only where the first call has one.
 */
int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n]$clock, $type $output[$n]);

/* The same, of measured counts as numbers: NAN for one that is missing, which the guards bridge, or stop for. */
int ${name}_sample(${name}_state *self, const double measured[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n]$clock, $type $output[$n]);

/* 0 while it runs, otherwise why it stops the arm, until ${name}_init. */
int ${name}_stopped(const ${name}_state *self);

/* The last cause that was bridged or stopped, its joint from 0, and the number of the call. */
int ${name}_event(const ${name}_state *self, int *joint, long *call);

/* 1 where the mechanical brakes should hold the arm: the law does so no longer. */
int ${name}_brake(const ${name}_state *self);

#ifdef __cplusplus
}
#endif

#endif
