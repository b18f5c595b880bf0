/* Packed moments of the target: M_r = psi^T diag(w u_r) psi for all r at once,
 *
 *     packed[(a, b), r] = (a == b ? 1 : 2) * sum over i of psi[i, a] psi[i, b] w[i] u[i, r],      a <= b
 *
 * A lane is a pair: a panel holds two runs of V pairs (a, b .. b + V - 1) named by `runs`; lanes with b >= k are not stored.
 *
 * moments: launch (ceil(panels / panels_per_item)); psi (n, k); runs (panels, 2, 2) int: a and first b of both halves; right
 *          (tiles, n, RT): diag(w) u by pack_tiles; sums (panels, tiles, RT, W) scratch; packed (k (k + 1) / 2, r)
 * numpy twin: clalign.engine.reference.Reference.packed_moments
 */
#include "panel.cl"

KERNEL void moments(const int n, const int k, const int r, const int panels, const int panels_per_item,
                    __global const real *restrict psi, __global const int *restrict runs,
                    __global const real *restrict right, __global real *restrict sums, __global real *restrict packed)
{
    const int tiles = (r + RT - 1) / RT;
    const int begin = get_global_id(0) * panels_per_item, end = min(begin + panels_per_item, panels);
    realv made[2 * FB];
    for (int row = 0; row < n; row += FB) {
        const int count = min(FB, n - row);
        for (int panel = begin; panel < end; ++panel) {
            __global const int *run = runs + 4 * panel;
            for (int t = 0; t < count; ++t) {
                __global const real *line = psi + (size_t)(row + t) * k;
                made[2 * t] = line[run[0]] * LOAD(__global, line + run[1]);
                made[2 * t + 1] = line[run[2]] * LOAD(__global, line + run[3]);
            }
            panel_times_tiles(made, count, right + (size_t)row * RT, (size_t)n * RT, tiles,
                              sums + (size_t)panel * tiles * RT * W, row == 0);
        }
    }
    for (int panel = begin; panel < end; ++panel)
        for (int lane = 0; lane < W; ++lane) {
            const int a = runs[4 * panel + 2 * (lane / V)], b = runs[4 * panel + 2 * (lane / V) + 1] + lane % V;
            if (b >= k) continue;
            __global real *to = packed + (size_t)(a * k - a * (a - 1) / 2 + b - a) * r;
            for (int j = 0; j < r; ++j)
                to[j] = (a == b ? ONE : ONE + ONE) * sums[((size_t)panel * tiles * RT + j) * W + lane];
        }
}
