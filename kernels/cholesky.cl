/* x = rhs (gram + shift I)^-1 with shift = ridge trace(gram) / k, by Cholesky gram + shift I = L L^T.
 *
 * factorise: launch one group of CHOLESKY_ITEMS; gram (k, k); factor (k, k), lower triangle L. Column by column: the items
 *            share the rows of a column, whose entries are dot products of finished rows. A negative pivot gives NaN.
 * solve_rows: launch (ceil(m / W)); rhst (row panels, k, W): rhs transposed by pack_panels, overwritten; factor (k, k);
 *            x (m, k). L y = rhs_j^T by rows of L, then L^T x = y, again by rows of L.
 * numpy twin: clalign.engine.reference.Reference.solve_right
 */
#include "sums.cl"

#ifndef CHOLESKY_ITEMS
#define CHOLESKY_ITEMS 8 /* work-items of the one group that factorises */
#endif

KERNEL_OF(CHOLESKY_ITEMS) void factorise(const int k, const real ridge, __global const real *restrict gram,
                                         __global real *factor)
{
    const int item = get_local_id(0);
    real shift = ZERO;
    for (int i = 0; i < k; ++i) shift += gram[(size_t)i * k + i];
    shift *= ridge / (real)k;
    for (int j = 0; j < k; ++j) {
        const size_t row = (size_t)j * k;
        const real pivot = sqrt(gram[row + j] + shift - dot_rows(factor + row, factor + row, j));
        for (int i = j + 1 + item; i < k; i += CHOLESKY_ITEMS) {
            const real rest = gram[(size_t)i * k + j] - dot_rows(factor + (size_t)i * k, factor + row, j);
            factor[(size_t)i * k + j] = rest / pivot;
        }
        if (item == 0) factor[row + j] = pivot;
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}

KERNEL void solve_rows(const int m, const int k, __global const real *restrict factor, __global real *restrict rhst,
                       __global real *restrict x)
{
    const int panel = get_global_id(0);
    if (panel * W >= m) return;
    __global real *y = rhst + (size_t)panel * k * W;
    for (int j = 0; j < k; ++j) {
        __global const real *line = factor + (size_t)j * k;
        realv rest0 = LOAD(__global, y + j * W), rest1 = LOAD(__global, y + j * W + V);
        for (int t = 0; t < j; ++t) {
            rest0 -= line[t] * LOAD(__global, y + t * W);
            rest1 -= line[t] * LOAD(__global, y + t * W + V);
        }
        STORE(__global, y + j * W, rest0 / line[j]);
        STORE(__global, y + j * W + V, rest1 / line[j]);
    }
    for (int j = k - 1; j >= 0; --j) {
        __global const real *line = factor + (size_t)j * k;
        const realv done0 = LOAD(__global, y + j * W) / line[j], done1 = LOAD(__global, y + j * W + V) / line[j];
        STORE(__global, y + j * W, done0);
        STORE(__global, y + j * W + V, done1);
        for (int t = 0; t < j; ++t) {
            STORE(__global, y + t * W, LOAD(__global, y + t * W) - line[t] * done0);
            STORE(__global, y + t * W + V, LOAD(__global, y + t * W + V) - line[t] * done1);
        }
    }
    for (int lane = 0; lane < min(W, m - panel * W); ++lane)
        for (int j = 0; j < k; ++j) x[(size_t)(panel * W + lane) * k + j] = y[j * W + lane];
}
