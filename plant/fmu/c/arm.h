/* $made */
#ifndef ${NAME}_H
#define ${NAME}_H

/* A geared arm between two steps. */
typedef struct {
    double state[$states];
} ${name}_state;

#endif
