/* -- sine, cosine and exponential: of sums and products alone, so that every processor gives the same bits -- */

/* Taylor's series of an angle within +-pi/4, or its derivative; NaN beyond a million quarter turns. */
__attribute__((unused)) static double turned(double angle, int ahead)
{
    static const double odd[] = {1.0 / 355687428096000.0, -1.0 / 1307674368000.0, 1.0 / 6227020800.0,
        -1.0 / 39916800.0, 1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0};
    static const double even[] = {-1.0 / 6402373705728000.0, 1.0 / 20922789888000.0, -1.0 / 87178291200.0,
        1.0 / 479001600.0, -1.0 / 3628800.0, 1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0};
    const double count = floor(angle * 0.6366197723675814 + 0.5);
    if (!(fabs(count) <= 1048576.0))
        return NAN;
    const double rest =
        ((angle - count * 1.5707963267341256) - count * 6.077100506303966e-11) - count * 2.0222662487959506e-21;
    const double square = rest * rest;
    const int quarter = (int)(count - 4.0 * floor(count / 4.0)) + ahead;
    double sum = 0.0;
    for (int i = 0; i < 8; i++)
        sum = sum * square + (quarter % 2 ? even[i] : odd[i]);
    sum = quarter % 2 ? 1.0 - (0.5 * square - square * square * sum) : rest + rest * square * sum;
    return quarter / 2 % 2 ? -sum : sum;
}

__attribute__((unused)) static double sine(double angle)
{
    return turned(angle, 0);
}

__attribute__((unused)) static double cosine(double angle)
{
    return turned(angle, 1);
}

__attribute__((unused)) static double exponential(double x)
{
    if (!(x < 709.0))
        return x + INFINITY;
    if (x < -745.0)
        return 0.0;
    const double count = floor(x * 1.4426950408889634 + 0.5);
    const double rest = (x - count * 0.6931471803691238) - count * 1.9082149292705877e-10;
    double sum = 1.0;
    for (int i = 14; i > 0; i--)
        sum = sum * rest / i + 1.0;
    return ldexp(sum, (int)count);
}

