/* $made
 *
 * Replays a record:  ./$name record.csv > $output.csv
 * Time per step:     ./$name --time record.csv
 * In its own time:   ./$name --paced 60 record.csv       (on Linux; the jitter of 60 s, again and again over the record)
 *
 * A line of the record holds the counts of the $n joints, then q_r, qd_r and qdd_r of each [rad, rad/s, rad/s^2], with
 * commas between them; a first line of names, empty lines and those that begin with # are skipped.
 */
#define _POSIX_C_SOURCE 200809L
#include "$name.h"

#include <ctype.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef __linux__
#include <sched.h>
#include <sys/mman.h>
#endif

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

static int step(${name}_state *self, const row *now, $type $output[$size])
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

static int step(${name}_state *self, const row *now, $type $output[$size])
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

#ifdef __linux__
static int64_t nanoseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1000000000 * (int64_t)now.tv_sec + now.tv_nsec;
}

/* One step per period, each begun at its own instant; how late they began [ns], and how many ended after their period. */
static int paced(const row *rows, size_t count, int64_t steps)
{
    enum { BINS = 32 };
    const int64_t period = (int64_t)(1e9 * ${NAME}_PERIOD + 0.5);
    const struct sched_param above = {.sched_priority = 80};
    const int first = !sched_setscheduler(0, SCHED_FIFO, &above), kept = !mlockall(MCL_CURRENT | MCL_FUTURE);
    int64_t bins[BINS] = {0}, least = INT64_MAX, most = 0, late = 0, longest = 0;
    ${name}_state self;
    $type $output[$size];
    const int64_t start = nanoseconds() + 10 * period;
    for (int64_t k = 0; k < steps; k++) {
        const int64_t due = start + k * period;
        const struct timespec at = {.tv_sec = due / 1000000000, .tv_nsec = due % 1000000000};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL))
            ;
        const int64_t woke = nanoseconds();
        if (k % (int64_t)count == 0)
            begin(&self, rows);
        step(&self, &rows[k % (int64_t)count], $output);
        const int64_t done = nanoseconds(), delay = woke - due;
        int bin = 0;
        while (bin < BINS - 1 && delay >= (int64_t)1000 << bin)
            bin++;
        bins[bin]++;
        longest = done - woke > longest ? done - woke : longest;
        if (done - due > period) {
            late++;
            continue;
        }
        least = delay < least ? delay : least;
        most = delay > most ? delay : most;
    }
    printf("%s, memory %s\n", first ? "SCHED_FIFO" : "no priority", kept ? "locked" : "not locked");
    for (int bin = 0; bin < BINS; bin++)
        if (bins[bin])
            printf("begun less than %lld us late: %lld\n", 1LL << bin, (long long)bins[bin]);
    printf("longest step: %.1f us\n", (double)longest / 1e3);
    printf("late steps: %lld of %lld\n", (long long)late, (long long)steps);
    if (late < steps)
        printf("of the others jitter=%.4f\n", (double)(most - least) / 2.0 / (double)period);
    return 0;
}
#endif

int main(int argc, char **argv)
{
#ifdef __linux__
    if (argc == 4 && !strcmp(argv[1], "--paced")) {
        size_t lines;
        const int64_t steps = (int64_t)(strtod(argv[2], NULL) / ${NAME}_PERIOD);
        row *const along = steps > 0 ? rows_of(argv[3], &lines) : NULL;
        if (!along)
            return 2;
        const int failed = paced(along, lines, steps);
        free(along);
        return failed;
    }
#endif
    const int timed = argc == 3 && !strcmp(argv[1], "--time");
    size_t count;
    $type $output[$size];
    ${name}_state self;
    if (argc != 2 + timed) {
        fprintf(stderr, "usage: %s [--time | --paced seconds] record.csv\n", argv[0]);
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
            for (int i = 0; i < $size; i++)
                printf("%s$format", i ? "," : "", $output[i]);
            putchar('\n');
        }
    }
    free(rows);
    return 0;
}
