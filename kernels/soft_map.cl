/* The soft map as a quadratic form (Eq. 15, 27): for every row c_j of C Phi
 *
 *     z[j, r] = factor[j] * sum over pairs a <= b of c[j, a] c[j, b] packed[(a, b), r]
 *
 * factor = 1 / s gives Z = P^T U; factor = w and a doubled right side give the gradient of the packed moments.
 *
 * soft_map: launch (ceil(row panels / panels_per_item)); ct (row panels, k, W): c transposed by pack_panels; right
 *           (tiles, pairs, RT): packed by pack_tiles; factor (n); sums (row panels, tiles, RT, W) scratch; z (n, r)
 * numpy twin: clalign.engine.reference.Reference.soft_map, packed_moments_gradient
 */
#include "panel.cl"

KERNEL void soft_map(const int n, const int k, const int r, const int panels_per_item, __global const real *restrict ct,
                     __global const real *restrict right, __global const real *restrict factor,
                     __global real *restrict sums, __global real *restrict z)
{
    const int pairs = k * (k + 1) / 2, tiles = (r + RT - 1) / RT, row_panels = (n + W - 1) / W;
    const int begin = get_global_id(0) * panels_per_item, end = min(begin + panels_per_item, row_panels);
    realv made[2 * FB];
    int block_a = 0, block_b = 0;
    for (int pair = 0; pair < pairs; pair += FB) {
        const int count = min(FB, pairs - pair);
        int a = block_a, b = block_b;
        for (int panel = begin; panel < end; ++panel) {
            __global const real *rows = ct + (size_t)panel * k * W;
            a = block_a;
            b = block_b;
            for (int t = 0; t < count;) {
                const int run = min(count - t, k - b);
                const realv left0 = LOAD(__global, rows + a * W), left1 = LOAD(__global, rows + a * W + V);
                for (int i = 0; i < run; ++i) {
                    made[2 * (t + i)] = left0 * LOAD(__global, rows + (b + i) * W);
                    made[2 * (t + i) + 1] = left1 * LOAD(__global, rows + (b + i) * W + V);
                }
                t += run;
                b += run;
                if (b == k) b = ++a;
            }
            panel_times_tiles(made, count, right + (size_t)pair * RT, (size_t)pairs * RT, tiles,
                              sums + (size_t)panel * tiles * RT * W, pair == 0);
        }
        block_a = a;
        block_b = b;
    }
    for (int panel = begin; panel < end; ++panel)
        for (int lane = 0; lane < min(W, n - panel * W); ++lane) {
            const size_t row = panel * W + lane;
            for (int j = 0; j < r; ++j)
                z[row * r + j] = factor[row] * sums[((size_t)panel * tiles * RT + j) * W + lane];
        }
}
