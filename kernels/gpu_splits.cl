/* What ends a product of the class of GPUs whose depth was split: the sums of the splits, in order, and one elementwise step.
 *
 * sum_splits:      launch (m n); c (m, n) = scale * sum of sums (splits, m, n) [+ c when accumulate]; symmetric: what lies below
 *                  the diagonal is taken from above it
 * finish_soft_map: launch (n ROW_ITEMS); z[j, :] = factor_j * sum of sums (splits, n, r), factor_j = factor[j] where that is not
 *                  NULL, else 1 / s_j or 0, and s[j] = s_j is stored: sum of weights (splits, n) where that is not NULL, else
 *                  c[j, :] . cn[j, :], both (n, k)
 * finish_gradient: launch (n ROW_ITEMS); dc[j, :] = 1 / s_j (scale * sum of sums (splits, n, k) - 2 (dz[j, :] . z[j, :]) cn[j, :]),
 *                  without the last term where cn (n, k) is NULL; dz, z (n, r)
 * numpy twins: clalign.engine.reference.Reference.weighted_gram, packed_moments, packed_moments_gradient, soft_map,
 * soft_map_streamed, soft_map_gradient, soft_map_streamed_gradient
 */
#include "gpu_sums.cl"

#define ROW_ITEMS 32 /* neighbouring items of a row */

INLINE real inverse_of(const real value)
{
    return value == ZERO ? ZERO : ONE / value;
}

INLINE real row_dot(__global const real *x, __global const real *y, const int count, __local real *space)
{
    real sum = ZERO;
    for (int t = get_local_id(0) % ROW_ITEMS; t < count; t += ROW_ITEMS) sum += x[t] * y[t];
    return group_sum(sum, space, ROW_ITEMS);
}

INLINE real sum_of(__global const real *sums, const int splits, const size_t stride)
{
    real sum = ZERO;
    for (int split = 0; split < splits; ++split) sum += sums[split * stride];
    return sum;
}

KERNEL void sum_splits(const int m, const int n, const int splits, const real scale, const int accumulate, const int symmetric,
                       __global const real *restrict sums, __global real *restrict c)
{
    const int e = get_global_id(0);
    if (e >= m * n) return;
    const int from = symmetric && e / n > e % n ? e % n * n + e / n : e;
    const real value = scale * sum_of(sums + from, splits, (size_t)m * n);
    c[e] = accumulate ? c[e] + value : value;
}

KERNEL void finish_soft_map(const int n, const int r, const int k, const int splits, __global const real *restrict sums,
                            __global const real *restrict factor, __global const real *restrict weights,
                            __global const real *c, __global const real *cn, __global real *restrict s,
                            __global real *restrict z)
{
    __local real space[WG];
    const int row = get_global_id(0) / ROW_ITEMS, lane = get_global_id(0) % ROW_ITEMS, own = min(row, n - 1);
    real scale;
    if (factor)
        scale = factor[own];
    else {
        const real mass = weights ? sum_of(weights + own, splits, n)
                                  : row_dot(c + (size_t)own * k, cn + (size_t)own * k, k, space);
        if (row < n && lane == 0) s[row] = mass;
        scale = inverse_of(mass);
    }
    if (row >= n) return;
    for (int j = lane; j < r; j += ROW_ITEMS) {
        const size_t e = (size_t)row * r + j;
        z[e] = scale * sum_of(sums + e, splits, (size_t)n * r);
    }
}

KERNEL void finish_gradient(const int n, const int k, const int r, const int splits, const real scale,
                            __global const real *restrict sums, __global const real *restrict cn,
                            __global const real *restrict z, __global const real *restrict dz, __global const real *restrict s,
                            __global real *restrict dc)
{
    __local real space[WG];
    const int row = get_global_id(0) / ROW_ITEMS, lane = get_global_id(0) % ROW_ITEMS, own = min(row, n - 1);
    const real removed = cn ? 2 * row_dot(dz + (size_t)own * r, z + (size_t)own * r, r, space) : ZERO;
    if (row >= n) return;
    const real inverse = inverse_of(s[row]);
    for (int a = lane; a < k; a += ROW_ITEMS) {
        const size_t e = (size_t)row * k + a;
        const real sum = scale * sum_of(sums + e, splits, (size_t)n * k);
        dc[e] = inverse * (cn ? sum - removed * cn[e] : sum);
    }
}
