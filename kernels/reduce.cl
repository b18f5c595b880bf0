/* Deterministic sums in two stages: sum over i of a[i] b[i], or of a[i] when b is NULL.
 *
 * partial_dots: launch (parts); part p sums elements p RB .. (p + 1) RB - 1 into partial[p]
 * finish_sum:   launch (1); out[0] = scale * sum of partial (parts) [+ out[0] when accumulate], compensated (Kahan)
 * finish_rows:  launch (rows); out[i] = sum of partial[i, :] (rows, parts)
 * numpy twin: clalign.engine.reference.Reference.total
 */
#include "sums.cl"

#ifndef RB
#define RB 512 /* elements of one part */
#endif

KERNEL void partial_dots(const int count, __global const real *a, __global const real *b, __global real *restrict partial)
{
    const int begin = get_global_id(0) * RB, end = min(begin + RB, count);
    if (begin >= count) return;
    realv sum0 = 0, sum1 = 0;
    int i = begin;
    if (b) {
        for (; i + W <= end; i += W) {
            sum0 += LOAD(__global, a + i) * LOAD(__global, b + i);
            sum1 += LOAD(__global, a + i + V) * LOAD(__global, b + i + V);
        }
    } else {
        for (; i + W <= end; i += W) {
            sum0 += LOAD(__global, a + i);
            sum1 += LOAD(__global, a + i + V);
        }
    }
    real rest = ZERO;
    for (; i < end; ++i) rest += b ? a[i] * b[i] : a[i];
    partial[get_global_id(0)] = lane_sum(sum0 + sum1) + rest;
}

KERNEL void finish_sum(const int parts, const real scale, const int accumulate, __global const real *restrict partial,
                       __global real *restrict out)
{
    if (get_global_id(0) > 0) return;
    const real total = compensated_sum(parts, partial);
    out[0] = accumulate ? out[0] + scale * total : scale * total;
}

KERNEL void finish_rows(const int rows, const int parts, __global const real *restrict partial, __global real *restrict out)
{
    const int i = get_global_id(0);
    if (i >= rows) return;
    real total = ZERO;
    for (int p = 0; p < parts; ++p) total += partial[(size_t)i * parts + p];
    out[i] = total;
}
