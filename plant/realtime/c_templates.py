"""The C files that `Law.to_c` writes, but for what the equations say; ``$name`` and the like are filled in."""

from string import Template

HEADER = Template("""\
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
$stops */
int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n], $type $output[$n]);

#ifdef __cplusplus
}
#endif

#endif
""")

SOURCE = Template("""\
/* $made */
#include "$name.h"

#include <math.h>

/* -- numbers -- */
$numbers
$helpers$guards/* -- the law -- */
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
$guard    for (int i = 0; i < $n; i++)
        $output[i] = self->$output[i];
    return $result;
}
""")

MAIN = Template("""\
/* $made
 *
 * Replays a record:  ./$name record.csv > $output.csv
 * Time per step:     ./$name --time record.csv
 *
 * A line of the record holds the counts of the $n joints, then q_r, qd_r and qdd_r of each [rad, rad/s, rad/s^2], with
 * commas between them; a first line of names, empty lines and those that begin with # are skipped.
 */
#include "$name.h"

#include <ctype.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct {
    int32_t pulses[$n];
    double motion[3][$n];
} row;

/* Whether a line holds what a row needs, and no more. */
static int parsed(const char *text, row *to)
{
    char *end;
    for (int i = 0; i < 4 * $n; i++, text = end + 1) {
        errno = 0;
        if (i < $n) {
            const long long count = strtoll(text, &end, 10);
            if (errno || count < INT32_MIN || count > INT32_MAX)
                return 0;
            to->pulses[i] = (int32_t)count;
        } else {
            to->motion[i / $n - 1][i % $n] = strtod(text, &end);
        }
        if (end == text || (i + 1 < 4 * $n && *end != ','))
            return 0;
    }
    return end[strspn(end, " \\t\\r\\n")] == '\\0';
}

static int step(${name}_state *self, const row *now, $type $output[$n])
{
    return ${name}_step(self, now->pulses, now->motion[0], now->motion[1], now->motion[2], $output);
}

/* All rows of a file; NULL, with a message, if it has none or one that is wrong. */
static row *rows_of(const char *path, size_t *count)
{
    char line[128 + 128 * $n];
    row *rows = NULL;
    size_t capacity = 0, number = 0;
    FILE *file = fopen(path, "r");
    *count = 0;
    if (!file) {
        fprintf(stderr, "%s cannot be read: %s\\n", path, strerror(errno));
        return NULL;
    }
    while (fgets(line, sizeof line, file)) {
        number++;
        if (line[0] == '#' || line[strspn(line, " \\t\\r\\n")] == '\\0')
            continue;
        if (number == 1 && isalpha((unsigned char)line[0]))
            continue;
        if (*count == capacity) {
            row *more = realloc(rows, (capacity = 2 * capacity + 1024) * sizeof *rows);
            if (!more) {
                fprintf(stderr, "%s does not fit into memory\\n", path);
                goto refused;
            }
            rows = more;
        }
        if (!parsed(line, &rows[(*count)++])) {
            fprintf(stderr, "%s line %zu must hold %d counts and %d numbers\\n", path, number, $n, 3 * $n);
            goto refused;
        }
    }
    fclose(file);
    if (!*count)
        fprintf(stderr, "%s holds no row\\n", path);
    return rows;
refused:
    fclose(file);
    free(rows);
    return NULL;
}

int main(int argc, char **argv)
{
    const int timed = argc == 3 && !strcmp(argv[1], "--time");
    size_t count;
    int code = 0;
    $type $output[$n];
    ${name}_state self;
    if (argc != 2 + timed) {
        fprintf(stderr, "usage: %s [--time] record.csv\\n", argv[0]);
        return 2;
    }
    row *rows = rows_of(argv[1 + timed], &count);
    if (!rows)
        return 1;
    ${name}_init(&self);
    if (timed) {
        size_t steps = 0;
        const clock_t start = clock();
        while (clock() - start < CLOCKS_PER_SEC / 2) {
            ${name}_init(&self);
            for (size_t k = 0; k < count; k++)
                step(&self, &rows[k], $output);
            steps += count;
        }
        printf("%.1f ns per step\\n", 1e9 * (double)(clock() - start) / CLOCKS_PER_SEC / (double)steps);
    } else {
        for (size_t k = 0; k < count; k++) {
            const int before = code;
            code = step(&self, &rows[k], $output);
            if (code == 1) {
                fprintf(stderr, "no finite torque in row %zu\\n", k + 1);
                free(rows);
                return 1;
            }
            if (code != before)
                fprintf(stderr, "safe stop in row %zu: %s\\n", k + 1, code == 2 ? "saturation" : "chatter");
            for (int i = 0; i < $n; i++)
                printf("%s$format", i ? "," : "", $output[i]);
            putchar('\\n');
        }
    }
    free(rows);
    return 0;
}
""")

MAKEFILE = Template("""\
# $made
CFLAGS ?= -std=c99 -O2 -Wall -Wextra -pedantic

$name: main.o $name.o
\t$$(CC) $$(LDFLAGS) -o $$@ main.o $name.o -lm

main.o $name.o: $name.h

clean:
\trm -f $name main.o $name.o

.PHONY: clean
""")
