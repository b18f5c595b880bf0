/* Gradient of the soft map with respect to c:
 *
 *     dc_j = (2 / s_j) [ (sum_r dz[j, r] M_r) c_j - removed_j N c_j ],      removed_j = sum_r dz[j, r] z[j, r]
 *
 * For every pair (a, b) a tile gives g_j = sum_r dz[j, r] packed[(a, b), r]; then dc[j, a] += g_j c[j, b] and
 * dc[j, b] += g_j c[j, a], which with doubled off-diagonals is the product with 2 M. g is never stored.
 *
 * soft_map_gradient: launch (ceil(row panels / panels_per_item)); ct, cn (row panels, k, W): c and c N transposed by
 *           pack_panels; dzt (row panels, r, W): dz transposed; packed (pairs, r); removed, inverse (n, padded to W), the
 *           latter 1 / s; sums (row panels, k, W) scratch; dc (n, k)
 * numpy twin: clalign.engine.reference.Reference.soft_map_gradient
 */
#include "tile.cl"

#ifndef PB
#define PB 96 /* pairs of a block: PB r reals of packed stay in the first or second cache */
#endif

/* All RT pairs share a: its row of dc is kept in registers. */
#define SPREAD_RUN(i)                                                              \
    {                                                                              \
        __global const real *other = c + (b + i) * W;                              \
        __global real *slope = d + (b + i) * W;                                    \
        along0 += p##i * LOAD(__global, other);                                    \
        along1 += q##i * LOAD(__global, other + V);                                \
        STORE(__global, slope, LOAD(__global, slope) + p##i * left0);              \
        STORE(__global, slope + V, LOAD(__global, slope + V) + q##i * left1);      \
    }
#define ADD(to, value) STORE(__global, to, LOAD(__global, to) + (value))
#define SPREAD_ONE(i)                                                              \
    if (i < valid_rows) {                                                          \
        ADD(d + a * W, p##i * LOAD(__global, c + b * W));                          \
        ADD(d + a * W + V, q##i * LOAD(__global, c + b * W + V));                  \
        ADD(d + b * W, p##i * LOAD(__global, c + a * W));                          \
        ADD(d + b * W + V, q##i * LOAD(__global, c + a * W + V));                  \
        if (++b == k) b = ++a;                                                     \
    }

KERNEL void soft_map_gradient(const int n, const int k, const int r, const int panels_per_item,
                              __global const real *restrict ct, __global const real *restrict cn,
                              __global const real *restrict dzt, __global const real *restrict packed,
                              __global const real *restrict removed, __global const real *restrict inverse,
                              __global real *restrict sums, __global real *restrict dc)
{
    const int pairs = k * (k + 1) / 2, row_panels = (n + W - 1) / W;
    const int begin = get_global_id(0) * panels_per_item, end = min(begin + panels_per_item, row_panels);
    for (int panel = begin; panel < end; ++panel) {
        const realv removed0 = LOAD(__global, removed + panel * W), removed1 = LOAD(__global, removed + panel * W + V);
        for (size_t a = (size_t)panel * k * W; a < (size_t)(panel + 1) * k * W; a += W) {
            STORE(__global, sums + a, -(removed0 + removed0) * LOAD(__global, cn + a));
            STORE(__global, sums + a + V, -(removed1 + removed1) * LOAD(__global, cn + a + V));
        }
    }
    int block_a = 0, block_b = 0;
    for (int block = 0; block < pairs; block += PB) {
        const int block_end = min(block + PB, pairs);
        int a = block_a, b = block_b;
        for (int panel = begin; panel < end; ++panel) {
            __global const real *c = ct + (size_t)panel * k * W, *slopes = dzt + (size_t)panel * r * W;
            __global real *d = sums + (size_t)panel * k * W;
            a = block_a;
            b = block_b;
            for (int pair = block; pair < block_end; pair += RT) {
                TILE_BEGIN(r, block_end - pair)
                TILE_STEPS(__global, slopes, W, packed + (size_t)pair * r, 1, r)
                if (b > a && b + RT <= k && valid_rows >= RT) {
                    const realv left0 = LOAD(__global, c + a * W), left1 = LOAD(__global, c + a * W + V);
                    realv along0 = LOAD(__global, d + a * W), along1 = LOAD(__global, d + a * W + V);
                    EACH(SPREAD_RUN)
                    STORE(__global, d + a * W, along0);
                    STORE(__global, d + a * W + V, along1);
                    b += RT;
                    if (b == k) b = ++a;
                } else {
                    EACH(SPREAD_ONE)
                }
            }
        }
        block_a = a;
        block_b = b;
    }
    for (int panel = begin; panel < end; ++panel)
        for (int lane = 0; lane < min(W, n - panel * W); ++lane) {
            const size_t row = panel * W + lane;
            for (int j = 0; j < k; ++j) dc[row * k + j] = inverse[row] * sums[((size_t)panel * k + j) * W + lane];
        }
}
