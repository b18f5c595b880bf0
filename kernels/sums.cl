/* Sums that end a kernel, each in one fixed order with short chains of additions: the shorter, the smaller the rounding error.
 *
 *     lane_sum(v)           = sum of the V lanes of a vector
 *     dot_rows(x, y, count) = sum over t < count of x[t] y[t]
 *     compensated_sum(count, values) = sum over i < count of values[i] (Kahan)
 *
 * No kernels of their own: x, y, values (count) in global memory, one work-item calls; numpy twin: numpy.sum.
 */
#if PRECISION == 64
#define LANES(count) double##count
#else
#define LANES(count) float##count
#endif

/* Half onto half: a loop over the lanes goes through memory. */
INLINE real lane_sum(const realv sums)
{
#if V == 16
    const LANES(8) eight = sums.lo + sums.hi;
    const LANES(4) four = eight.lo + eight.hi;
#elif V == 8
    const LANES(4) four = sums.lo + sums.hi;
#else
    const LANES(4) four = sums;
#endif
    const LANES(2) two = four.lo + four.hi;
    return two.x + two.y;
}

INLINE real dot_rows(__global const real *x, __global const real *y, const int count)
{
    realv sums = 0;
    int t = 0;
    for (; t + V <= count; t += V) sums += LOAD(__global, x + t) * LOAD(__global, y + t);
    real rest = ZERO;
    for (; t < count; ++t) rest += x[t] * y[t];
    return lane_sum(sums) + rest;
}

INLINE real compensated_sum(const int count, __global const real *values)
{
    real total = ZERO, lost = ZERO;
    for (int i = 0; i < count; ++i) {
        const real term = values[i] - lost, next = total + term;
        lost = (next - total) - term;
        total = next;
    }
    return total;
}
