/* The hard map of a soft one: for every row c_j of C Phi the largest entry of its column of P (Eq. 16, 28)
 *
 *     index[j] = argmax_i w_i (psi_i . c_j)^2,      score[j] that maximum;      w_i >= 0
 *
 * soft_map_argmax: launch (ceil(row groups / GROUPS)); c (n, k); psi packed by pack_panels (panels, k, W); w (n_y);
 *           index (n) int, score (n)
 * numpy twin: clalign.engine.reference.Reference.soft_map_argmax
 */
#include "best.cl"

#define SCORE(product, bias) ((bias) * (product) * (product))

KERNEL void soft_map_argmax(const int n, const int n_y, const int k, __global const real *restrict c,
                            __global const real *restrict psi, __global const real *restrict w, __global int *restrict index,
                            __global real *restrict score)
{
    const int row_begin = get_global_id(0) * GROUPS * RT;
    if (row_begin >= n) return;
    const int rows = min(GROUPS * RT, n - row_begin), groups = (rows + RT - 1) / RT;
    realv best[GROUPS * RT * 2];
    intv where[GROUPS * RT * 2];
    for (int i = 0; i < groups * RT * 2; ++i) {
        best[i] = -INFINITY;
        where[i] = 0;
    }
    for (int panel = 0; panel < (n_y + W - 1) / W; ++panel) {
        /* Lanes beyond n_y read whatever follows w, but psi is zero there: their scores of 0 lose every tie. */
        const realv bias0 = LOAD(__global, w + panel * W), bias1 = LOAD(__global, w + panel * W + V);
        for (int group = 0; group < groups; ++group) {
            TILE_BEGIN(k, rows - group * RT)
            TILE_STEPS(__global, psi + (size_t)panel * W * k, W, c + (size_t)(row_begin + group * RT) * k, 1, k)
            EACH(KEEP_ROW)
        }
    }
    write_best(rows, best, where, index + row_begin, score + row_begin);
}
