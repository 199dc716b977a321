/* $made
 *
$about
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_JOINTS $n
#define ${NAME}_PERIOD $period /* [s], from one call of ${name}_step to the next */

/* One controller; several do not know of each other. */
typedef struct {
    double torque[$n]; /* acting now: joint torque after the amplifier's limit [N m] */
$state} ${name}_state;

/* To be called first, and whenever the controller starts anew. */
void ${name}_init(${name}_state *self);

/* One sample: what to apply until the next call.
 *
 * pulses            encoder counts of the motors, read now
 * q_r, qd_r, qdd_r  reference for now, joint side [rad, rad/s, rad/s^2]
 * $output            $meaning
 *
 * Gives 0. Where the law has no finite torque (a NaN or an infinity came in) it gives 1, nothing in *self changes,
 * and what is given is that of the last torque: the caller decides how to stop.
 */
int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n], $type $output[$n]);

#ifdef __cplusplus
}
#endif

#endif
