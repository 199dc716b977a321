/* The loop of scalar.c, as fast as it could be made: eight individuals in the lanes of a vector, two vectors at a time.
 *
 * Units are chosen so that little is left to multiply. The state of an individual is
 *
 *     x  = q in the middle of the coming step, in pulses of encoder 0, so that encoder 0 only truncates
 *     w  = FINE h qd [rad]; from one middle to the next, x grows by w times a constant
 *     n1 = impulse of joint 1, against the motion; that of joint 0 is worked out anew by every first sweep
 *
 * D stands for D + h/2 viscous, divided by its constant element 11 so that D11 = 1; torques are multiplied by
 * FINE h^2 / D11. With a = f3 cos q1 - f4 sin q1 and b = f3 sin q1 + f4 cos q1 (f divided alike, b by FINE besides),
 * D00 = f7 + 2 a, D01 = f2 + a, d = D01 / D00 and pivot = D00 - D01^2, a step is
 *
 *     tau0 = rest0 + b w1 (w1 + 2 w0)      tau1 = rest1 - b w0^2            at w, then at the predicted w
 *     y0 = tau0 - D01 tau1                 y1 = tau1 - d tau0
 *     predicted w0 + y0 / (2 pivot)        w1 + y1 D00 / (2 pivot)          first time
 *     y0 += pivot w0                       y1 += pivot/D00 w1               second time
 *     n0 = limited(y0 + D01 n1)            n1 = limited(y1 + d n0)          three sweeps
 *     w0 = (y0 + D01 n1 - n0) / pivot      w1 = (y1 + d n0 - n1) D00 / pivot
 *
 * An impulse starts within its bound and the bound is constant, so the first clamp is left out.
 *
 * Sine and cosine: the angle less the nearest multiple of pi/8, polynomials, and sine and cosine of the multiple from
 * tables in registers; in the RENEW - 1 steps after that they are turned by the angle moved, by the addition theorem
 * and shorter polynomials. Absolute error below 3e-15 up to 40 rad; beyond, the rounding of the angle weighs more.
 *
 * Whether all is well is watched as cheaply as possible: for each lane one `or` a step over the exponents of w, which
 * shows a joint that ever moved 2/FINE rad in a step (45 rad/s in 0.175 ms), and beforehand whether D can cease to be
 * positive at any q. What that does not prove well is simulated again with every check in every step.
 *
 * Tried; times relative to this file, AVX-512, 240 individuals, one thread:
 *
 *     sine and cosine anew in every step (RENEW 1)                                        1.14
 *     one vector in a step                                                                1.15
 *     three vectors in a step (more values than registers)                                1.12
 *     two vectors in the loop over time instead of ten                                    1.42
 *     two, three or five vectors whose state stays in registers, RENEW 1                  1.60, 1.42, 1.45
 *     three stages of three vectors interleaved, with values handed on through memory     1.28
 *     sines of two vectors at a time, then friction of five at a time                     1.04
 *     one division for both quotients                                                     1.02
 *     clamps by a minimum and a maximum                                                   1.11
 *     every check in every step                                                           1.13
 *     the equations of scalar.c in loops of `omp simd` over 40 or 16 lanes, no vector types,
 *     sine and cosine by quadrants (needs -fno-trapping-math to become vectors)           3.12, 2.89
 *
 * gcc -O3 -march=native -ffp-contract=fast -shared -fPIC vector.c -lm
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "experiment.h"
#ifdef __AVX2__
#include <immintrin.h>
#endif

#ifdef __AVX512DQ__
#define LANES 8
#else
#define LANES 4
#endif
#ifndef RENEW
#define RENEW 8 /* sine and cosine are computed anew in every RENEWth step; 1: in every step */
#endif
#define VECTORS 10 /* side by side in the loop over time; their states and numbers fit the first cache */
#define FINE 256.0 /* makes w so large that its exponent shows when turning by it is not exact enough */

typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ivec __attribute__((vector_size(8 * LANES)));

/* What all individuals share; constants too, for literals are read from memory wherever they are used, while these can
 * stay in registers through the loop over time. */
struct shared {
    double pulses;   /* of encoder 0 per rad, signed */
    double growth;   /* pulses of encoder 0 per w */
    double eighth;   /* pi/8 per pulse of encoder 0 */
    double ratio;    /* pulses of encoder 1 per pulse of encoder 0 at the same angle */
    double limit[2]; /* error at which the amplifier saturates [pulses] */
    double far_x, far_w;
    long samples, steps_per_sample;
    const double *reference; /* in the middle of the steps [pulses] */
    const double *off;       /* measured error minus reference at the samples [pulses] */
    double half, two, magic, sine[5], cosine[4], turn_sine[3], turn_cosine[2], table[20];
};

/* Numbers and state of as many individuals as a vector has lanes. */
struct individuals {
    vec a3, a4, b3, b4, D00, D01, g5, g6, g8, g9, viscous0, viscous1, push0, push1, bound0, bound1;
    vec x0, x1, w0, w1, n1, s0, c0, s1, c1, score;
    ivec ok;
};

static const double FAR = 1e6; /* a position [rad] or velocity [rad/s] beyond this has diverged */

#define INLINE static inline __attribute__((always_inline))

INLINE vec all(double x)
{
    return x - (vec){0};
}

INLINE ivec bits(vec x)
{
    return (ivec)x;
}

/* x within +-bound */
INLINE vec limited(vec x, vec bound)
{
#if defined __AVX512DQ__
    return (vec)_mm512_range_pd((__m512d)x, (__m512d)bound, 2); /* the lesser magnitude, with the sign of x */
#elif defined __AVX2__
    return (vec)_mm256_min_pd(_mm256_max_pd((__m256d)x, (__m256d)-bound), (__m256d)bound);
#else
    const ivec above = x > bound, below = x < -bound;
    return (vec)((bits(bound) & above) | (bits(-bound) & below) | (bits(x) & ~(above | below)));
#endif
}

INLINE vec truncated(vec x)
{
#if defined __AVX512DQ__
    return (vec)_mm512_roundscale_pd((__m512d)x, _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC);
#elif defined __AVX2__
    return (vec)_mm256_round_pd((__m256d)x, _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC);
#else
    for (int l = 0; l < LANES; ++l)
        x[l] = trunc(x[l]);
    return x;
#endif
}

/* table[k mod 16] */
INLINE vec looked_up(const double *table, ivec k)
{
#if defined __AVX512DQ__
    return (vec)_mm512_permutex2var_pd(_mm512_loadu_pd(table), (__m512i)k, _mm512_loadu_pd(table + 8));
#else
    vec x;
    for (int l = 0; l < LANES; ++l)
        x[l] = table[k[l] & 15];
    return x;
#endif
}

/* A statement for n vectors, one after the other, so that their latencies overlap. */
#define EACH(n) _Pragma("GCC unroll 4") for (int i = 0; i < (n); ++i)

/* Sine and cosine of n angles x. */
INLINE void sines(int n, const vec *x, vec *s, vec *c, const struct shared *e)
{
    vec k[4], r[4], z[4], sine[4], cosine[4], table_s[4], table_c[4];
    EACH(n) k[i] = x[i] * e->eighth + e->magic; /* the nearest whole number in its lowest bits */
    EACH(n) r[i] = x[i] * e->eighth - (k[i] - e->magic);
    EACH(n) z[i] = r[i] * r[i];
    EACH(n) sine[i] = z[i] * e->sine[4] + e->sine[3];
    EACH(n) cosine[i] = z[i] * e->cosine[3] + e->cosine[2];
    EACH(n) sine[i] = sine[i] * z[i] + e->sine[2];
    EACH(n) cosine[i] = cosine[i] * z[i] + e->cosine[1];
    EACH(n) sine[i] = sine[i] * z[i] + e->sine[1];
    EACH(n) cosine[i] = cosine[i] * z[i] + e->cosine[0];
    EACH(n) sine[i] = sine[i] * z[i] + e->sine[0];
    EACH(n) cosine[i] = cosine[i] * z[i]; /* cosine minus 1 */
    EACH(n) sine[i] = sine[i] * r[i];
    EACH(n) table_s[i] = looked_up(e->table, bits(k[i]));
    EACH(n) table_c[i] = looked_up(e->table + 4, bits(k[i]));
    EACH(n) s[i] = table_c[i] * sine[i] + table_s[i];
    EACH(n) c[i] = table_c[i] - table_s[i] * sine[i];
    EACH(n) s[i] = table_s[i] * cosine[i] + s[i];
    EACH(n) c[i] = table_c[i] * cosine[i] + c[i];
}

/* n sines and cosines turned by the small angles w. */
INLINE void turn(int n, const vec *w, vec *s, vec *c, const struct shared *e)
{
    vec z[4], sine[4], cosine[4];
    EACH(n) z[i] = w[i] * w[i];
    EACH(n) sine[i] = z[i] * e->turn_sine[2] + e->turn_sine[1];
    EACH(n) cosine[i] = z[i] * e->turn_cosine[1] + e->turn_cosine[0];
    EACH(n) sine[i] = sine[i] * z[i] + e->turn_sine[0];
    EACH(n) cosine[i] = cosine[i] * z[i]; /* cosine minus 1 */
    EACH(n) sine[i] = sine[i] * w[i];
    EACH(n) z[i] = c[i] * sine[i] + s[i];
    EACH(n) sine[i] = c[i] - s[i] * sine[i];
    EACH(n) s[i] = s[i] * cosine[i] + z[i];
    EACH(n) c[i] = c[i] * cosine[i] + sine[i];
}

/* Add to the score what n vectors are off at a sample. */
INLINE void sample(int n, struct individuals *p, const struct shared *e, const double *off)
{
    const double back = e->half * e->growth;
    for (int i = 0; i < n; ++i) {
        const vec off0 = off[0] + truncated(p[i].x0 - back * p[i].w0);
        const vec off1 = off[1] + truncated((p[i].x1 - back * p[i].w1) * e->ratio);
        p[i].score += off0 * off0 + off1 * off1;
    }
}

/* One step of n vectors. `moved` collects the exponents of w; `careful` keeps `ok` instead. */
INLINE vec step(int n, int careful, int anew, struct individuals *p, const struct shared *e, const double *reference,
                vec moved)
{
    vec x[4], *x0 = x, *x1 = x + n, w[4], *w0 = w, *w1 = w + n, s[4], *s0 = s, *s1 = s + n, c[4], *c0 = c, *c1 = c + n;
    vec a[2], b[2], u[2], v[2], D00[2], D01[2], d[2], pivot[2], pivot1[2], inverse0[2], inverse1[2], half0[2], half1[2];
    vec error0[2], error1[2], rest0[2], rest1[2], tau0[2], tau1[2], y0[2], y1[2], n0[2], n1[2], rest[2];

    EACH(n) x0[i] = p[i].x0;
    EACH(n) x1[i] = p[i].x1;
    EACH(n) w0[i] = p[i].w0;
    EACH(n) w1[i] = p[i].w1;
    if (anew) {
        sines(2 * n, x, s, c, e);
    } else {
        EACH(n) s0[i] = p[i].s0;
        EACH(n) s1[i] = p[i].s1;
        EACH(n) c0[i] = p[i].c0;
        EACH(n) c1[i] = p[i].c1;
        turn(2 * n, w, s, c, e);
    }
    if (RENEW > 1 && !careful) {
        EACH(n) p[i].s0 = s0[i];
        EACH(n) p[i].s1 = s1[i];
        EACH(n) p[i].c0 = c0[i];
        EACH(n) p[i].c1 = c1[i];
    }

    /* inertia */
    EACH(n) a[i] = p[i].a3 * c1[i];
    EACH(n) b[i] = p[i].b3 * s1[i];
    EACH(n) a[i] = a[i] - p[i].a4 * s1[i];
    EACH(n) b[i] = p[i].b4 * c1[i] + b[i];
    EACH(n) D01[i] = p[i].D01 + a[i];
    EACH(n) D00[i] = a[i] * e->two + p[i].D00;
    EACH(n) d[i] = D01[i] / D00[i];
    EACH(n) pivot[i] = D00[i] - D01[i] * D01[i];
    EACH(n) inverse0[i] = 1.0 / pivot[i];

    /* law, gravity and viscous friction */
    EACH(n) error0[i] = limited(reference[0] - truncated(x0[i]), all(e->limit[0]));
    EACH(n) error1[i] = limited(reference[1] - truncated(x1[i] * e->ratio), all(e->limit[1]));
    EACH(n) u[i] = p[i].g5 * c1[i] - p[i].g6 * s1[i];
    EACH(n) v[i] = p[i].g5 * s1[i] + p[i].g6 * c1[i];
    EACH(n) u[i] = c0[i] * u[i];
    EACH(n) u[i] = u[i] - s0[i] * v[i]; /* g5 cos(q0 + q1) - g6 sin(q0 + q1) */
    EACH(n) rest1[i] = u[i] - p[i].viscous1 * w1[i];
    EACH(n) rest0[i] = u[i] - p[i].viscous0 * w0[i];
    EACH(n) rest0[i] = p[i].g9 * c0[i] + rest0[i];
    EACH(n) rest0[i] = rest0[i] - p[i].g8 * s0[i];
    EACH(n) rest1[i] = p[i].push1 * error1[i] + rest1[i];
    EACH(n) rest0[i] = p[i].push0 * error0[i] + rest0[i];

    /* predictor */
    EACH(n) inverse1[i] = D00[i] * inverse0[i];
    EACH(n) pivot1[i] = 1.0 - D01[i] * d[i];
    EACH(n) half0[i] = inverse0[i] * e->half;
    EACH(n) half1[i] = inverse1[i] * e->half;
    EACH(n) tau0[i] = b[i] * w1[i] * (w0[i] * e->two + w1[i]) + rest0[i];
    EACH(n) tau1[i] = rest1[i] - b[i] * w0[i] * w0[i];
    EACH(n) y0[i] = tau0[i] - D01[i] * tau1[i];
    EACH(n) y1[i] = tau1[i] - d[i] * tau0[i];
    EACH(n) u[i] = y0[i] * half0[i] + w0[i];
    EACH(n) v[i] = y1[i] * half1[i] + w1[i];

    /* the step itself */
    EACH(n) tau0[i] = b[i] * v[i] * (u[i] * e->two + v[i]) + rest0[i];
    EACH(n) tau1[i] = rest1[i] - b[i] * u[i] * u[i];
    EACH(n) y0[i] = tau0[i] - D01[i] * tau1[i];
    EACH(n) y1[i] = tau1[i] - d[i] * tau0[i];
    EACH(n) y0[i] = pivot[i] * w0[i] + y0[i];
    EACH(n) y1[i] = pivot1[i] * w1[i] + y1[i];

    /* dry friction */
    EACH(n) n1[i] = p[i].n1;
    for (int sweep = 0; sweep < 3; ++sweep) {
        EACH(n) n0[i] = limited(D01[i] * n1[i] + y0[i], p[i].bound0);
        EACH(n) rest[i] = d[i] * n0[i] + y1[i];
        EACH(n) n1[i] = limited(rest[i], p[i].bound1);
    }
    EACH(n) y0[i] = D01[i] * n1[i] + y0[i];
    EACH(n) w1[i] = (rest[i] - n1[i]) * inverse1[i];
    EACH(n) w0[i] = (y0[i] - n0[i]) * inverse0[i];

    if (careful)
        EACH(n) p[i].ok &= (x0[i] < e->far_x) & (x0[i] > -e->far_x) & (x1[i] < e->far_x) & (x1[i] > -e->far_x) &
                           (w0[i] < e->far_w) & (w0[i] > -e->far_w) & (w1[i] < e->far_w) & (w1[i] > -e->far_w) &
                           (pivot[i] > 0.0);
    EACH(n) p[i].n1 = n1[i];
    EACH(n) p[i].w0 = w0[i];
    EACH(n) p[i].w1 = w1[i];
    EACH(n) p[i].x0 = w0[i] * e->growth + x0[i];
    EACH(n) p[i].x1 = w1[i] * e->growth + x1[i];
    EACH(n) moved = (vec)(bits(moved) | bits(w0[i]) | bits(w1[i]));
    return moved;
}

/* One step of all vectors: pairs, and the last alone if their number is odd. */
INLINE vec steps(int vectors, int careful, int anew, struct individuals *p, const struct shared *e,
                 const double *reference, vec moved)
{
    int j = 0;
    for (; j + 1 < vectors; j += 2)
        moved = step(2, careful, anew, p + j, e, reference, moved);
    if (j < vectors)
        moved = step(1, careful, anew, p + j, e, reference, moved);
    return moved;
}

INLINE vec simulate(int vectors, int careful, struct individuals *p, const struct shared *e)
{
    vec moved = {0};
    const double *reference = e->reference, *off = e->off;
    int left = 0; /* steps until sine and cosine are computed anew */
    for (long i = 0; i < e->samples; ++i, off += 2) {
        sample(vectors, p, e, off);
        for (long j = 0; j < e->steps_per_sample; ++j, reference += 2) {
            if (careful || left == 0) {
                moved = steps(vectors, careful, 1, p, e, reference, moved);
                left = RENEW - 1;
            } else {
                moved = steps(vectors, careful, 0, p, e, reference, moved);
                --left;
            }
        }
    }
    return moved;
}

static __attribute__((noinline)) vec simulate_fast(int vectors, struct individuals *p, const struct shared *e)
{
    return simulate(vectors, 0, p, e);
}

static __attribute__((noinline)) void simulate_careful(int vectors, struct individuals *p, const struct shared *e)
{
    simulate(vectors, 1, p, e);
}

/* Viscous friction of a joint [N m s/rad], joint side. */
static double viscous(const struct experiment *e, int joint)
{
    return e->viscous[joint] * e->gear[joint] * e->gear[joint];
}

/* D11 + h/2 viscous [kg m^2] */
static double last_inertia(const double *f, const struct experiment *e)
{
    return f[0] + 0.5 * e->h * viscous(e, 1);
}

/* Fill lane l of p with the individual f. */
static void fill(struct individuals *p, int l, const double *f, const struct experiment *e, const struct shared *o)
{
    const double h = e->h, inverse = 1.0 / last_inertia(f, e), scale = FINE * h * h * inverse;
    p->a3[l] = f[2] * inverse;
    p->a4[l] = f[3] * inverse;
    p->b3[l] = f[2] * inverse / FINE;
    p->b4[l] = f[3] * inverse / FINE;
    p->D00[l] = (f[6] + 0.5 * h * viscous(e, 0)) * inverse;
    p->D01[l] = f[1] * inverse;
    p->g5[l] = scale * e->gravity * f[4];
    p->g6[l] = scale * e->gravity * f[5];
    p->g8[l] = scale * e->gravity * f[7];
    p->g9[l] = scale * e->gravity * f[8];
    p->viscous0[l] = h * viscous(e, 0) * inverse;
    p->viscous1[l] = h * viscous(e, 1) * inverse;
    p->push0[l] = scale * e->gear[0] * e->gain[0];
    p->push1[l] = scale * e->gear[1] * e->gain[1];
    p->bound0[l] = scale * e->coulomb[0] * fabs(e->gear[0]);
    p->bound1[l] = scale * e->coulomb[1] * fabs(e->gear[1]);
    p->w0[l] = FINE * h * e->qd[0];
    p->w1[l] = FINE * h * e->qd[1];
    p->x0[l] = o->pulses * (e->q[0] + 0.5 * h * e->qd[0]);
    p->x1[l] = o->pulses * (e->q[1] + 0.5 * h * e->qd[1]);
    p->n1[l] = p->score[l] = 0.0;
    p->ok[l] = -1;
}

/* Whether D is positive at every q: its pivot is concave in a, and a stays within +-size. */
static int certain(const double *f, const struct experiment *e)
{
    const double inverse = 1.0 / last_inertia(f, e), size = hypot(f[2], f[3]) * inverse;
    const double D00 = (f[6] + 0.5 * e->h * viscous(e, 0)) * inverse, D01 = f[1] * inverse;
    const double largest = fabs(D00) + 2.0 * size + pow(fabs(D01) + size, 2.0);
    const double least = fmin(D00 - 2.0 * size - pow(D01 - size, 2.0), D00 + 2.0 * size - pow(D01 + size, 2.0));
    return least > 1e-9 * largest && largest < INFINITY;
}

/* Costs of the individuals rows[count]. Leaves in rows those whose cost has to be worked out with care; how many. */
static long costs_of(int careful, long count, long *rows, const double *f, const struct experiment *e,
                     const struct shared *o, struct individuals *p, double *cost)
{
    long again = 0;
    for (long start = 0; start < count; start += VECTORS * LANES) {
        const long here = count - start < VECTORS * LANES ? count - start : VECTORS * LANES;
        const int vectors = (int)((here + LANES - 1) / LANES);
        vec moved = {0};
        for (long i = 0; i < vectors * LANES; ++i) /* empty lanes repeat the last */
            fill(p + i / LANES, i % LANES, f + 9 * rows[start + (i < here ? i : here - 1)], e, o);
        if (careful)
            simulate_careful(vectors, p, o);
        else
            moved = simulate_fast(vectors, p, o);
        for (long i = 0; i < here; ++i) {
            const long row = rows[start + i];
            const double score = p[i / LANES].score[i % LANES];
            cost[row] = p[i / LANES].ok[i % LANES] && isfinite(score) ? score : INFINITY;
            if (!(fabs(moved[i % LANES]) < 2.0)) /* 2 and more, infinity and NaN have an exponent bit of their own */
                rows[again++] = row;
        }
    }
    return again;
}

/* Interface as of scalar_costs. */
void vector_costs(long population, const double *f, const struct experiment *e, long samples, long steps_per_sample,
                  const double *sample_reference, const double *step_reference, const double *measured, double *cost)
{
    /* sin(r pi/8) / r and (cos(r pi/8) - 1) / r^2 in powers of r^2 for abs(r) < 1/2, through Chebyshev nodes */
    static const double sine[5] = {0.39269908169872414, -0.01009318902353477, 7.782483030805464e-05,
                                   -2.857514779264285e-07, 6.114984947804156e-10};
    static const double cosine[4] = {-0.07710628438350989, 0.000990896515144638, -5.0936213565288685e-06,
                                     1.401478618191496e-08};
    static const double quarter[5] = {0.0, 0.3826834323650898, 0.7071067811865476, 0.9238795325112867, 1.0};
    struct shared o = {.samples = samples, .steps_per_sample = steps_per_sample, .reference = step_reference};
    double *off = malloc((2 * samples + 1) * sizeof *off);
    long *rows = malloc((2 * population + 1) * sizeof *rows), *other = rows + population, fast = 0, slow = 0;
    struct individuals *p = aligned_alloc(64, VECTORS * sizeof *p);

    o.pulses = e->gear[0] * e->resolution[0] / (8.0 * atan(1.0));
    o.growth = o.pulses / FINE;
    o.eighth = 16.0 / (e->gear[0] * e->resolution[0]);
    o.ratio = e->gear[1] * e->resolution[1] / (e->gear[0] * e->resolution[0]);
    for (int i = 0; i < 2; ++i)
        o.limit[i] = e->motor_gain[i] * e->current_limit[i] / e->gain[i];
    o.far_x = FAR * fabs(o.pulses);
    o.far_w = FAR * FINE * e->h;
    o.half = 0.5;
    o.two = 2.0;
    o.magic = 0x1.8p52;
    memcpy(o.sine, sine, sizeof sine);
    memcpy(o.cosine, cosine, sizeof cosine);
    for (int i = 0; i < 3; ++i)
        o.turn_sine[i] = (i == 0 ? 1.0 : i == 1 ? -1.0 / 6.0 : 1.0 / 120.0) / pow(FINE, 2 * i + 1);
    for (int i = 0; i < 2; ++i)
        o.turn_cosine[i] = (i == 0 ? -1.0 / 2.0 : 1.0 / 24.0) / pow(FINE, 2 * i + 2);
    for (int k = 0; k < 20; ++k) /* sin(k pi/8); cos(k pi/8) stands four further on */
        o.table[k] = (k / 8 % 2 ? -1.0 : 1.0) * quarter[k % 8 < 4 ? k % 8 : 8 - k % 8];
    for (long i = 0; i < 2 * samples; ++i)
        off[i] = measured[i] - sample_reference[i];
    o.off = off;

    /* A joint that moves less than 2/FINE rad per step is not FAR if the steps are long enough and not too many. */
    const double reach = fmax(fabs(e->q[0]), fabs(e->q[1])) + 2.0 / FINE * samples * steps_per_sample;
    const int ordinary = reach < FAR && o.far_w > 2.0;
    for (long i = 0; i < population; ++i) {
        cost[i] = INFINITY;
        if (!(last_inertia(f + 9 * i, e) > 0.0))
            continue; /* D11 is not positive */
        if (ordinary && certain(f + 9 * i, e))
            rows[fast++] = i;
        else
            other[slow++] = i;
    }
    fast = costs_of(0, fast, rows, f, e, &o, p, cost);
    memmove(rows + fast, other, slow * sizeof *rows);
    costs_of(1, fast + slow, rows, f, e, &o, p, cost);
    free(p);
    free(rows);
    free(off);
}
