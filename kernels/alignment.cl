/* Sums over the band that end the evaluation of l_align (Eq. 21, or Eq. 18), for R (d, d) zero outside its band.
 *
 *     slope[i, j] += factor * other[i, j]  inside the band;      with <R, X> = sum over the band of R_ij X_ij
 *     numerator   = <R, slope> / 2,                              denominator = <R, other> / 2
 *     one-sided:  numerator = <R, slope> / 2 - <R, other> + tr G_y,  denominator = tr G_y
 *
 * Both terms of Eq. 21 are quadratic forms, so half of <R, gradient> is their value. What lies outside the band in slope and
 * other is not read.
 *
 * band_rows:        launch (d); lower (d), offsets (d + 1) int; r, other, slope (d, d); partial (2, d): row sums of
 *                   <R, slope> and <R, other>
 * alignment_values: launch (1); g_y (d, d) one-sided, else NULL; numerator, denominator (1)
 * numpy twin: clalign.engine.reference.Reference.alignment
 */
#include "sums.cl"

KERNEL void band_rows(const int d, const real factor, __global const int *restrict lower, __global const int *restrict offsets,
                      __global const real *restrict r, __global const real *restrict other, __global real *restrict slope,
                      __global real *restrict partial)
{
    const int i = get_global_id(0);
    if (i >= d) return;
    const size_t begin = (size_t)i * d + lower[i], end = begin + offsets[i + 1] - offsets[i];
    realv sum0 = 0, sum1 = 0;
    real rest0 = ZERO, rest1 = ZERO;
    size_t j = begin;
    for (; j + V <= end; j += V) {
        const realv x = LOAD(__global, r + j), y = LOAD(__global, other + j);
        const realv z = LOAD(__global, slope + j) + factor * y;
        STORE(__global, slope + j, z);
        sum0 += x * z;
        sum1 += x * y;
    }
    for (; j < end; ++j) {
        slope[j] += factor * other[j];
        rest0 += r[j] * slope[j];
        rest1 += r[j] * other[j];
    }
    partial[i] = lane_sum(sum0) + rest0;
    partial[d + i] = lane_sum(sum1) + rest1;
}

KERNEL void alignment_values(const int d, __global const real *restrict partial, __global const real *restrict g_y,
                             __global real *restrict numerator, __global real *restrict denominator)
{
    if (get_global_id(0) > 0) return;
    const real with_slope = compensated_sum(d, partial) / 2, with_other = compensated_sum(d, partial + d);
    if (!g_y) {
        numerator[0] = with_slope;
        denominator[0] = with_other / 2;
        return;
    }
    real trace = ZERO;
    for (int i = 0; i < d; ++i) trace += g_y[(size_t)i * d + i];
    numerator[0] = with_slope - with_other + trace;
    denominator[0] = trace;
}
