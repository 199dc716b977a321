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

$types
/* To be called first, and whenever the controller starts anew, as after a stop. */
void ${name}_init(${name}_state *self$initial_counts);

/* One sample: what to apply until the next call.
 *
 * pulses            encoder counts of the motors, read now
 * q_r, qd_r, qdd_r  reference for now, joint side [rad, rad/s, rad/s^2]
$clock_meaning * $output            $meaning
 *
$refusal
 */
int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n]$clock, $type $output[$size]);

$other_declarations#ifdef __cplusplus
}
#endif

#endif
