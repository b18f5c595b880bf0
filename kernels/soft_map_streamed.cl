/* The soft map from tiles of q_ij = psi_i . c_j, which are made, used and forgotten (for large k):
 *
 *     z[j, r] = (1 / s_j) sum_i w_i q_ij^2 u[i, r],      s_j = sum_i w_i q_ij^2
 *     dc_j = (2 / s_j) sum_i w_i q_ij (sum_r dz[j, r] u[i, r] - removed_j) psi_i,   removed_j = sum_r dz[j, r] z[j, r]
 *
 * Both launch (ceil(row panels / panels_per_item)); ct (row panels, k, W): c transposed by pack_panels; psi (n_y, k); w (n_y).
 * soft_map_streamed: right (tiles, n_y, RT): u by pack_tiles; sums (row panels, tiles, RT, W) and weights (row panels, W)
 *           scratch; z (n, r); s (n)
 * soft_map_streamed_gradient: dzt (row panels, r, W); u (n_y, r); removed, inverse (n, padded to W); sums (row panels,
 *           k, W) scratch; dc (n, k)
 * numpy twins: clalign.engine.reference.Reference.soft_map_streamed, soft_map_streamed_gradient
 */
#include "panel.cl"

#define KEEP_Q(i)                                     \
    if (i < valid_rows) {                             \
        made[2 * (t + i)] = p##i;                     \
        made[2 * (t + i) + 1] = q##i;                 \
    }
#define SLOPE(i)                                                     \
    if (i < valid_rows) {                                            \
        const real weight = w[row + t + i];                          \
        made[2 * (t + i)] *= weight * (p##i - removed0);             \
        made[2 * (t + i) + 1] *= weight * (q##i - removed1);         \
    }
#define ADD_ROW(i)                                                   \
    if (i < valid_rows) {                                            \
        __global real *to = d + (a + i) * W;                         \
        STORE(__global, to, row ? LOAD(__global, to) + p##i : p##i); \
        STORE(__global, to + V, row ? LOAD(__global, to + V) + q##i : q##i); \
    }

/* q for `count` rows of psi from `row` on. */
INLINE void make_q(realv *made, const int row, const int count, const int k, __global const real *psi,
                   __global const real *c)
{
    for (int t = 0; t < count; t += RT) {
        TILE_BEGIN(k, count - t)
        TILE_STEPS(__global, c, W, psi + (size_t)(row + t) * k, 1, k)
        EACH(KEEP_Q)
    }
}

KERNEL void soft_map_streamed(const int n, const int n_y, const int k, const int r, const int panels_per_item,
                              __global const real *restrict ct, __global const real *restrict psi,
                              __global const real *restrict w, __global const real *restrict right,
                              __global real *restrict sums, __global real *restrict weights, __global real *restrict z,
                              __global real *restrict s)
{
    const int tiles = (r + RT - 1) / RT, row_panels = (n + W - 1) / W;
    const int begin = get_global_id(0) * panels_per_item, end = min(begin + panels_per_item, row_panels);
    realv made[2 * FB];
    for (int row = 0; row < n_y; row += FB) {
        const int count = min(FB, n_y - row);
        for (int panel = begin; panel < end; ++panel) {
            make_q(made, row, count, k, psi, ct + (size_t)panel * k * W);
            realv sum0 = 0, sum1 = 0;
            for (int t = 0; t < count; ++t) {
                made[2 * t] *= made[2 * t] * w[row + t];
                made[2 * t + 1] *= made[2 * t + 1] * w[row + t];
                sum0 += made[2 * t];
                sum1 += made[2 * t + 1];
            }
            __global real *weight = weights + panel * W;
            STORE(__global, weight, row ? LOAD(__global, weight) + sum0 : sum0);
            STORE(__global, weight + V, row ? LOAD(__global, weight + V) + sum1 : sum1);
            panel_times_tiles(made, count, right + (size_t)row * RT, (size_t)n_y * RT, tiles,
                              sums + (size_t)panel * tiles * RT * W, row == 0);
        }
    }
    for (int panel = begin; panel < end; ++panel)
        for (int lane = 0; lane < min(W, n - panel * W); ++lane) {
            const size_t row = panel * W + lane;
            const real weight = weights[row], inverse = weight == ZERO ? ZERO : ONE / weight;
            s[row] = weight;
            for (int j = 0; j < r; ++j)
                z[row * r + j] = inverse * sums[((size_t)panel * tiles * RT + j) * W + lane];
        }
}

KERNEL void soft_map_streamed_gradient(const int n, const int n_y, const int k, const int r, const int panels_per_item,
                                       __global const real *restrict ct, __global const real *restrict psi,
                                       __global const real *restrict w, __global const real *restrict u,
                                       __global const real *restrict dzt, __global const real *restrict removed,
                                       __global const real *restrict inverse, __global real *restrict sums,
                                       __global real *restrict dc)
{
    const int row_panels = (n + W - 1) / W;
    const int begin = get_global_id(0) * panels_per_item, end = min(begin + panels_per_item, row_panels);
    realv made[2 * FB];
    for (int row = 0; row < n_y; row += FB) {
        const int count = min(FB, n_y - row);
        for (int panel = begin; panel < end; ++panel) {
            __global const real *slopes = dzt + (size_t)panel * r * W;
            __global real *d = sums + (size_t)panel * k * W;
            const realv removed0 = LOAD(__global, removed + panel * W), removed1 = LOAD(__global, removed + panel * W + V);
            make_q(made, row, count, k, psi, ct + (size_t)panel * k * W);
            for (int t = 0; t < count; t += RT) {
                TILE_BEGIN(r, count - t)
                TILE_STEPS(__global, slopes, W, u + (size_t)(row + t) * r, 1, r)
                EACH(SLOPE)
            }
            for (int a = 0; a < k; a += RT) {
                TILE_BEGIN(1, k - a)
                TILE_STEPS(__private, (const real *)made, W, psi + (size_t)row * k + a, k, count)
                EACH(ADD_ROW)
            }
        }
    }
    for (int panel = begin; panel < end; ++panel)
        for (int lane = 0; lane < min(W, n - panel * W); ++lane) {
            const size_t row = panel * W + lane;
            for (int j = 0; j < k; ++j)
                dc[row * k + j] = (inverse[row] + inverse[row]) * sums[((size_t)panel * k + j) * W + lane];
        }
}
