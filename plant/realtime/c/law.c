/* $made */
#include "$name.h"

#include <math.h>

/* -- numbers -- */
$numbers
$helpers/* -- the law -- */
void ${name}_init(${name}_state *self)
{
$start$initial}

int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n], $type $output[$n])
{
$body

    int sound = 1;
    for (int i = 0; i < $n; i++)
        sound = sound && isfinite(asked[i]);
$check    if (sound) {
$store    }
    for (int i = 0; i < $n; i++)
        $output[i] = self->$kept[i];
    return !sound;
}
