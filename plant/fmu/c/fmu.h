/* $made */
#ifndef FMU_H
#define FMU_H

#include "$name.h"

#include <stdint.h>

#define FMU_TOKEN "$token"
#define JOINTS $n

/* Value references: 0 to REALS - 1, then WHOLES whole numbers; of both the first may be set. FMI 3 has time behind. */
enum { REALS = $reals, REALS_SET = $reals_set, WHOLES = $wholes, WHOLES_SET = $wholes_set };

/* All there is of an instance; a saved state is a copy. */
typedef struct {
    double real[REALS];
    double time;
    ${name}_state state;
    int32_t whole[WHOLES];
    int32_t phase;
} fmu_model;

enum { CREATED, INITIALISING, STEPPING, TERMINATED };

/* Start values; the outputs at the start; a step of h [s]. What cannot be done is said, NULL otherwise. */
void fmu_start(fmu_model *self);
const char *fmu_begin(fmu_model *self);
const char *fmu_step(fmu_model *self, double h);

#endif
