/* Kernels that touch every element once, for the class of GPUs: neighbouring items, neighbouring elements.
 *
 * add, scale_rows, gather_rows, reciprocal, band_expand, band_gather: an item for every element of the result, or of the square
 *            matrix; arguments and layouts are those of elementwise.cl
 * quotient:  value[0] = numerator[0] / denominator[0], and gradient (count) from the slopes (count) of both
 * row_dots:  launch (n ROW_ITEMS), that many neighbouring items a row
 * transpose: launch (ceil(columns / TB) WG, ceil(rows / TB)); blocks of TB x TB elements through local memory, WG / TB rows of
 *            them at once; TB divides WG
 * numpy twins: clalign.engine.reference.Reference.add, quotient, scale_rows, reciprocal, gather, half_squares, transpose,
 * band_expand, band_gather
 */
#include "gpu_sums.cl"

#ifndef TB
#error "TB must be given: the rows and columns of a block of a transpose"
#endif
#define ROW_ITEMS 32

KERNEL void add(const int count, const real scale_a, const real scale_b, __global const real *a, __global const real *b,
                __global real *out)
{
    const int i = get_global_id(0);
    if (i < count) out[i] = scale_a * a[i] + scale_b * b[i];
}

KERNEL void quotient(const int count, __global const real *restrict numerator, __global const real *restrict denominator,
                     __global const real *restrict slope, __global const real *restrict denominator_slope,
                     __global real *restrict value, __global real *restrict gradient)
{
    const int i = get_global_id(0);
    if (i >= count) return;
    const real scale = ONE / denominator[0], ratio = numerator[0] * scale;
    if (i == 0) value[0] = ratio;
    gradient[i] = scale * slope[i] - ratio * scale * denominator_slope[i];
}

KERNEL void scale_rows(const int n, const int k, __global const real *a, __global const real *restrict w, __global real *out)
{
    const int i = get_global_id(0);
    if (i < n * k) out[i] = w[i / k] * a[i];
}

KERNEL void gather_rows(const int count, const int k, __global const real *restrict a, __global const int *restrict index,
                        __global real *restrict out)
{
    const int i = get_global_id(0);
    if (i < count * k) out[i] = a[(size_t)index[i / k] * k + i % k];
}

KERNEL void row_dots(const int n, const int k, const real scale, __global const real *a, __global const real *b,
                     __global real *restrict dots)
{
    __local real space[WG];
    const int i = get_global_id(0) / ROW_ITEMS, own = min(i, n - 1), lane = get_local_id(0) % ROW_ITEMS;
    real sum = ZERO;
    for (int t = lane; t < k; t += ROW_ITEMS) sum += a[(size_t)own * k + t] * b[(size_t)own * k + t];
    sum = group_sum(sum, space, ROW_ITEMS);
    if (i < n && lane == 0) dots[i] = scale * sum;
}

KERNEL void reciprocal(const int n, __global const real *s, __global real *out)
{
    const int i = get_global_id(0);
    if (i < n) out[i] = s[i] == ZERO ? ZERO : ONE / s[i];
}

KERNEL void transpose(const int rows, const int columns, __global const real *restrict a, __global real *restrict out)
{
    __local real block[TB * (TB + 1)];
    const int x = get_local_id(0) % TB, first_row = get_group_id(1) * TB, first_column = get_group_id(0) * TB;
    for (int y = get_local_id(0) / TB; y < TB; y += WG / TB)
        if (first_row + y < rows && first_column + x < columns)
            block[y * (TB + 1) + x] = a[(size_t)(first_row + y) * columns + first_column + x];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int y = get_local_id(0) / TB; y < TB; y += WG / TB)
        if (first_column + y < columns && first_row + x < rows)
            out[(size_t)(first_column + y) * rows + first_row + x] = block[x * (TB + 1) + y];
}

KERNEL void band_expand(const int d, __global const int *restrict lower, __global const int *restrict offsets,
                        __global const real *restrict values, __global real *restrict matrix)
{
    const int e = get_global_id(0);
    if (e >= d * d) return;
    const int i = e / d, at = e % d - lower[i];
    matrix[e] = at >= 0 && at < offsets[i + 1] - offsets[i] ? values[offsets[i] + at] : ZERO;
}

KERNEL void band_gather(const int d, __global const int *restrict lower, __global const int *restrict offsets,
                        __global const real *restrict matrix, __global real *restrict values)
{
    const int e = get_global_id(0);
    if (e >= d * d) return;
    const int i = e / d, at = e % d - lower[i];
    if (at >= 0 && at < offsets[i + 1] - offsets[i]) values[offsets[i] + at] = matrix[e];
}
