/* $made */
#include "$name.h"

#include <math.h>

$numbers
$helpers$code/* -- the controller -- */
void ${name}_init(${name}_state *self$initial_counts)
{
$start}

int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n]$clock, $type $output[$size])
{
$step}
$other_definitions