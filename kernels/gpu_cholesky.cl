/* x = rhs (gram + shift I)^-1 with shift = ridge trace(gram) / k, by Cholesky gram + shift I = L L^T, for the class of GPUs.
 *
 * By blocks of EDGE columns. An item of `factorise` owns a row of a block: what finished columns take away from it, then the
 * triangular solve with the block on the diagonal, which all items factorise in local memory. L and its transpose share one
 * matrix, so that neighbouring items always read neighbouring numbers: L[i, j] is at (i, j) and at (j, i).
 *
 * factorise:  launch (WG), one group; gram (k, k); factor (k, k), L mirrored. A negative pivot gives NaN.
 * solve_rows: launch (ceil(m / EDGE) WG); an item owns one of EDGE columns of one of EDGE rows of x: y = L^-1 rhs_j^T block by
 *             block, then L^-T y from the last block on; factor (k, k); rhs, x (m, k)
 * numpy twin: clalign.engine.reference.Reference.solve_right
 */
#include "gpu_sums.cl"

#define EDGE 16 /* rows and columns of a block: its square is the work-group */
#if WG != EDGE * EDGE
#error "WG must be 256"
#endif
#define BLOCK_ROW (EDGE + 1)

KERNEL void factorise(const int k, const real ridge, __global const real *restrict gram, __global real *factor)
{
    __local real space[WG], diagonal[EDGE * BLOCK_ROW], done[EDGE * EDGE];
    const int item = get_local_id(0);
    real trace = ZERO;
    for (int i = item; i < k; i += WG) trace += gram[(size_t)i * k + i];
    const real shift = group_sum(trace, space, WG) * ridge / (real)k;
    for (int block = 0; block < k; block += EDGE) {
        const int width = min(EDGE, k - block);
        /* The rows of the block on the diagonal come first: it is factorised before the others are solved with it. */
        for (int first = block; first < k; first += WG) {
            const int row = first + item, inside = row < k;
            real rest[EDGE];
            #pragma unroll
            for (int j = 0; j < EDGE; ++j)
                rest[j] = inside && j < width ? gram[(size_t)row * k + block + j] + (row == block + j ? shift : ZERO) : ZERO;
            for (int t = 0; t < block; t += EDGE) {
                barrier(CLK_LOCAL_MEM_FENCE);
                done[item] = item % EDGE < width ? factor[(size_t)(t + item / EDGE) * k + block + item % EDGE] : ZERO;
                barrier(CLK_LOCAL_MEM_FENCE);
                if (inside)
                    for (int step = 0; step < EDGE; ++step) {
                        const real own = factor[(size_t)(t + step) * k + row];
                        #pragma unroll
                        for (int j = 0; j < EDGE; ++j) rest[j] -= own * done[step * EDGE + j];
                    }
            }
            if (first == block) {
                if (item < EDGE) {
                    #pragma unroll
                    for (int j = 0; j < EDGE; ++j) diagonal[item * BLOCK_ROW + j] = rest[j];
                }
                barrier(CLK_LOCAL_MEM_FENCE);
                for (int j = 0; j < width; ++j) {
                    const int i = item / EDGE, other = item % EDGE;
                    const real pivot = sqrt(diagonal[j * BLOCK_ROW + j]);
                    barrier(CLK_LOCAL_MEM_FENCE);
                    if (other == j && i >= j && i < width)
                        diagonal[i * BLOCK_ROW + j] = i == j ? pivot : diagonal[i * BLOCK_ROW + j] / pivot;
                    barrier(CLK_LOCAL_MEM_FENCE);
                    if (i > j && other > j && other <= i && i < width)
                        diagonal[i * BLOCK_ROW + other] -= diagonal[i * BLOCK_ROW + j] * diagonal[other * BLOCK_ROW + j];
                    barrier(CLK_LOCAL_MEM_FENCE);
                }
            }
            if (inside) {
                const int on_diagonal = row < block + EDGE;
                #pragma unroll
                for (int j = 0; j < EDGE; ++j) {
                    if (on_diagonal)
                        rest[j] = diagonal[(row - block) * BLOCK_ROW + j];
                    else {
                        rest[j] /= diagonal[j * BLOCK_ROW + j];
                        #pragma unroll
                        for (int t = 0; t < EDGE; ++t)
                            if (t > j) rest[t] -= rest[j] * diagonal[t * BLOCK_ROW + j];
                    }
                    if (block + j <= row) {
                        factor[(size_t)(block + j) * k + row] = rest[j];
                        factor[(size_t)row * k + block + j] = rest[j];
                    }
                }
            }
        }
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
    }
}

KERNEL void solve_rows(const int m, const int k, __global const real *restrict factor, __global const real *restrict rhs,
                       __global real *x)
{
    __local real diagonal[EDGE * BLOCK_ROW], solved[EDGE];
    const int i = get_local_id(0) / EDGE, j = get_local_id(0) % EDGE, row = get_group_id(0) * EDGE + i;
    const int blocks = (k + EDGE - 1) / EDGE;
    rhs += (size_t)min(row, m - 1) * k;
    x += (size_t)min(row, m - 1) * k;
    for (int turn = 0; turn < 2 * blocks; ++turn) {
        const int backward = turn >= blocks, block = (backward ? 2 * blocks - 1 - turn : turn) * EDGE;
        const int width = min(EDGE, k - block), inside = row < m && j < width;
        real rest = ZERO;
        if (inside) {
            rest = backward ? x[block + j] : rhs[block + j];
            const int last = backward ? k : block;
            for (int first = backward ? block + width : 0; first < last; first += EDGE) {
                real part = ZERO;
                for (int t = first; t < min(first + EDGE, last); ++t) part += x[t] * factor[(size_t)t * k + block + j];
                rest -= part;
            }
        }
        if (i < width && j < width) diagonal[i * BLOCK_ROW + j] = factor[(size_t)(block + i) * k + block + j];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int step = 0; step < width; ++step) {
            const int e = backward ? width - 1 - step : step;
            if (j == e) {
                rest /= diagonal[e * BLOCK_ROW + e];
                solved[i] = rest;
            }
            barrier(CLK_LOCAL_MEM_FENCE);
            if (backward ? j < e : j > e && j < width) rest -= solved[i] * diagonal[j * BLOCK_ROW + e];
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        if (inside) x[block + j] = rest;
        barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
    }
}
