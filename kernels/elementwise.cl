/* Kernels that touch every element once.
 *
 * All launch (ceil(count / EB)) work-items of EB elements, or one work-item a row.
 * add:         out = scale_a a + scale_b b                          (count)
 * scale_rows:  out[i, :] = w[i] a[i, :]                             a (n, k), w (n)
 * gather_rows: out[i, :] = a[index[i], :]                           a (*, k), index (count)
 * row_dots:    dots[i] = a[i, :] . b[i, :], inverse[i] = 1 / dots[i] or 0; inverse may be NULL      a, b (n, k)
 * reciprocal:  out[i] = 1 / s[i] or 0                             (n)
 * transpose:   launch (ceil(columns / TB)), TB rows of the result each; out (columns, rows) = a (rows, columns)
 * band_expand: matrix (d, d) from values, lower (d), offsets (d + 1): row i holds columns lower[i] on
 * band_gather: values from matrix
 * numpy twins: clalign.engine.reference.Reference.add, scale_rows, reciprocal, gather, half_squares, transpose, band_expand,
 * band_gather; gather is gather_rows, half_squares row_dots of a matrix with itself and then add
 */
#include "sums.cl"

#ifndef EB
#error "EB must be given: the elements of one work-item"
#endif
#ifndef TB
#error "TB must be given: the rows and columns of a block of a transpose"
#endif

KERNEL void add(const int count, const real scale_a, const real scale_b, __global const real *a, __global const real *b,
                __global real *out)
{
    const int begin = get_global_id(0) * EB, end = min(begin + EB, count);
    for (int i = begin; i < end; ++i) out[i] = scale_a * a[i] + scale_b * b[i];
}

KERNEL void scale_rows(const int n, const int k, __global const real *a, __global const real *restrict w, __global real *out)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    for (size_t j = (size_t)i * k; j < (size_t)(i + 1) * k; ++j) out[j] = w[i] * a[j];
}

KERNEL void gather_rows(const int count, const int k, __global const real *restrict a, __global const int *restrict index,
                        __global real *restrict out)
{
    const int i = get_global_id(0);
    if (i >= count) return;
    __global const real *from = a + (size_t)index[i] * k;
    for (int j = 0; j < k; ++j) out[(size_t)i * k + j] = from[j];
}

KERNEL void row_dots(const int n, const int k, __global const real *a, __global const real *b, __global real *restrict dots,
                     __global real *restrict inverse)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    const real total = dot_rows(a + (size_t)i * k, b + (size_t)i * k, k);
    dots[i] = total;
    if (inverse) inverse[i] = total == ZERO ? ZERO : ONE / total;
}

KERNEL void reciprocal(const int n, __global const real *s, __global real *out)
{
    const int begin = get_global_id(0) * EB, end = min(begin + EB, n);
    for (int i = begin; i < end; ++i) out[i] = s[i] == ZERO ? ZERO : ONE / s[i];
}

KERNEL void transpose(const int rows, const int columns, __global const real *restrict a, __global real *restrict out)
{
    const int first = get_global_id(0) * TB, last = min(first + TB, columns);
    for (int block = 0; block < rows; block += TB) {
        __global const real *from = a + (size_t)block * columns + first;
        __global real *to = out + (size_t)first * rows + block;
        if (last - first == TB && rows - block >= TB)
            for (int j = 0; j < TB; ++j)
                for (int i = 0; i < TB; ++i) to[(size_t)j * rows + i] = from[(size_t)i * columns + j];
        else
            for (int j = 0; j < last - first; ++j)
                for (int i = 0; i < min(TB, rows - block); ++i) to[(size_t)j * rows + i] = from[(size_t)i * columns + j];
    }
}

KERNEL void band_expand(const int d, __global const int *restrict lower, __global const int *restrict offsets,
                        __global const real *restrict values, __global real *restrict matrix)
{
    const int i = get_global_id(0);
    if (i >= d) return;
    const int width = offsets[i + 1] - offsets[i];
    __global real *row = matrix + (size_t)i * d;
    for (int j = 0; j < lower[i]; ++j) row[j] = ZERO;
    for (int j = 0; j < width; ++j) row[lower[i] + j] = values[offsets[i] + j];
    for (int j = lower[i] + width; j < d; ++j) row[j] = ZERO;
}

KERNEL void band_gather(const int d, __global const int *restrict lower, __global const int *restrict offsets,
                        __global const real *restrict matrix, __global real *restrict values)
{
    const int i = get_global_id(0);
    if (i >= d) return;
    for (int j = offsets[i]; j < offsets[i + 1]; ++j)
        values[j] = matrix[(size_t)i * d + lower[i] + j - offsets[i]];
}
