/* Deterministic sums in two stages, and the sums over the band that end l_align, for the class of GPUs.
 *
 *     total = sum over i of a[i] b[i], or of a[i] when b is NULL
 *     slope[i, j] += factor * other[i, j]  inside the band of R (d, d);    numerator, denominator as alignment.cl says
 *
 * whole_dot:        launch (WG), few elements: out[0] = scale * total [+ out[0] when accumulate]
 * partial_dots:     launch (parts WG); part p sums elements p RB .. (p + 1) RB - 1 into partial[p]
 * finish_sum:       launch (WG); out[0] = scale * sum of partial (parts) [+ out[0] when accumulate]
 * band_rows:        launch (d WG), a work-group a row; lower (d), offsets (d + 1) int; r, other, slope (d, d); partial (2, d)
 * alignment_values: launch (WG); partial (2, d); g_y (d, d) one-sided, else NULL; numerator, denominator (1)
 * numpy twins: clalign.engine.reference.Reference.total, alignment
 */
#include "gpu_sums.cl"

#ifndef RB
#define RB 4096 /* elements of one part */
#endif
#define RUN 16 /* elements of an item that are summed in a row */

KERNEL void partial_dots(const int count, __global const real *a, __global const real *b, __global real *restrict partial)
{
    __local real space[WG];
    const int begin = get_group_id(0) * RB, end = min(begin + RB, count);
    real sum = ZERO;
    for (int i = begin + (int)get_local_id(0); i < end; i += WG) sum += b ? a[i] * b[i] : a[i];
    sum = group_sum(sum, space, WG);
    if (get_local_id(0) == 0) partial[get_group_id(0)] = sum;
}

KERNEL void whole_dot(const int count, const real scale, const int accumulate, __global const real *a,
                      __global const real *b, __global real *restrict out)
{
    __local real space[WG];
    real total = ZERO;
    /* Sums of short runs, which are then added: short chains of additions, small rounding error. */
    for (int first = 0; first < count; first += RUN * WG) {
        real sum = ZERO;
        for (int i = first + (int)get_local_id(0); i < min(first + RUN * WG, count); i += WG) sum += b ? a[i] * b[i] : a[i];
        total += sum;
    }
    total = group_sum(total, space, WG);
    if (get_local_id(0) == 0) out[0] = accumulate ? out[0] + scale * total : scale * total;
}

/* Sum of `count` values, all items taking part. */
INLINE real strided_sum(const int count, __global const real *values, const int stride, __local real *space)
{
    real sum = ZERO;
    for (int i = get_local_id(0); i < count; i += WG) sum += values[(size_t)i * stride];
    return group_sum(sum, space, WG);
}

KERNEL void finish_sum(const int parts, const real scale, const int accumulate, __global const real *restrict partial,
                       __global real *restrict out)
{
    __local real space[WG];
    const real total = strided_sum(parts, partial, 1, space);
    if (get_local_id(0) == 0) out[0] = accumulate ? out[0] + scale * total : scale * total;
}

KERNEL void band_rows(const int d, const real factor, __global const int *restrict lower, __global const int *restrict offsets,
                      __global const real *restrict r, __global const real *restrict other, __global real *restrict slope,
                      __global real *restrict partial)
{
    __local real space[WG];
    const int i = get_group_id(0), item = get_local_id(0), width = offsets[i + 1] - offsets[i];
    real with_slope = ZERO, with_other = ZERO;
    for (int j = item; j < width; j += WG) {
        const size_t e = (size_t)i * d + lower[i] + j;
        const real sum = slope[e] + factor * other[e];
        slope[e] = sum;
        with_slope += r[e] * sum;
        with_other += r[e] * other[e];
    }
    with_slope = group_sum(with_slope, space, WG);
    with_other = group_sum(with_other, space, WG);
    if (item > 0) return;
    partial[i] = with_slope;
    partial[d + i] = with_other;
}

KERNEL void alignment_values(const int d, __global const real *restrict partial, __global const real *restrict g_y,
                             __global real *restrict numerator, __global real *restrict denominator)
{
    __local real space[WG];
    const real with_slope = strided_sum(d, partial, 1, space) / 2, with_other = strided_sum(d, partial + d, 1, space);
    const real trace = strided_sum(g_y ? d : 0, g_y, d + 1, space);
    if (get_local_id(0) > 0) return;
    numerator[0] = g_y ? with_slope - with_other + trace : with_slope;
    denominator[0] = g_y ? trace : with_other / 2;
}
