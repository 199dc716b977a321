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
#include <math.h>
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
    return end[strspn(end, " \t\r\n")] == '\0';
}

#ifdef ${NAME}_GUARDED
static void begin(${name}_state *self, const row *first)
{
    ${name}_init(self, first->pulses);
}

static int step(${name}_state *self, const row *now, $type $output[$n])
{
    return ${name}_step(self, now->pulses, now->motion[0], now->motion[1], now->motion[2], ${never}$output);
}

static int stopped(const ${name}_state *self)
{
    return ${name}_stopped(self);
}
#else
static void begin(${name}_state *self, const row *first)
{
    (void)first;
    ${name}_init(self);
}

static int step(${name}_state *self, const row *now, $type $output[$n])
{
    return ${name}_step(self, now->pulses, now->motion[0], now->motion[1], now->motion[2], $output);
}

static int stopped(const ${name}_state *self)
{
    (void)self;
    return 0;
}
#endif

/* All rows of a file; NULL, with a message, if it has none or one that is wrong. */
static row *rows_of(const char *path, size_t *count)
{
    char line[128 + 128 * $n];
    row *rows = NULL;
    size_t capacity = 0, number = 0;
    FILE *file = fopen(path, "r");
    *count = 0;
    if (!file) {
        fprintf(stderr, "%s cannot be read: %s\n", path, strerror(errno));
        return NULL;
    }
    while (fgets(line, sizeof line, file)) {
        number++;
        if (line[0] == '#' || line[strspn(line, " \t\r\n")] == '\0')
            continue;
        if (number == 1 && isalpha((unsigned char)line[0]))
            continue;
        if (*count == capacity) {
            row *more = realloc(rows, (capacity = 2 * capacity + 1024) * sizeof *rows);
            if (!more) {
                fprintf(stderr, "%s does not fit into memory\n", path);
                goto refused;
            }
            rows = more;
        }
        if (!parsed(line, &rows[(*count)++])) {
            fprintf(stderr, "%s line %zu must hold %d counts and %d numbers\n", path, number, $n, 3 * $n);
            goto refused;
        }
    }
    fclose(file);
    if (!*count)
        fprintf(stderr, "%s holds no row\n", path);
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
    $type $output[$n];
    ${name}_state self;
    if (argc != 2 + timed) {
        fprintf(stderr, "usage: %s [--time] record.csv\n", argv[0]);
        return 2;
    }
    row *rows = rows_of(argv[1 + timed], &count);
    if (!rows)
        return 1;
    begin(&self, rows);
    if (timed) {
        size_t steps = 0;
        const clock_t start = clock();
        while (clock() - start < CLOCKS_PER_SEC / 2) {
            begin(&self, rows);
            for (size_t k = 0; k < count; k++)
                step(&self, &rows[k], $output);
            steps += count;
        }
        printf("%.1f ns per step\n", 1e9 * (double)(clock() - start) / CLOCKS_PER_SEC / (double)steps);
    } else {
        for (size_t k = 0; k < count; k++) {
            const int before = stopped(&self);
            if (step(&self, &rows[k], $output)) {
                fprintf(stderr, "no finite torque in row %zu\n", k + 1);
                free(rows);
                return 1;
            }
            if (stopped(&self) != before)
                fprintf(stderr, "safe stop in row %zu: cause %d of $name.h\n", k + 1, stopped(&self));
            for (int i = 0; i < $n; i++)
                printf("%s$format", i ? "," : "", $output[i]);
            putchar('\n');
        }
    }
    free(rows);
    return 0;
}
