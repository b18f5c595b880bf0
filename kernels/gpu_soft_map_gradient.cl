/* Gradient of the soft map with respect to c, for the class of GPUs; without its last step, which `finish_gradient` does:
 *
 *     sums[j, :] = 2 (sum_r dz[j, r] M_r) c_j
 *
 * A tile holds g[j, (a, b)] = sum_r dz[j, r] packed[(a, b), r] for TM rows and the 8 x 8 pairs of a block of M. It goes through
 * local memory, 64 rows at a time, where every item adds up what rows j of it give to one column of dc: g c[j, b] to column a,
 * g c[j, a] to column b, which with doubled off-diagonals is the product with 2 M. g is never stored.
 *
 * soft_map_gradient: launch (row tiles WG, splits); c (n, k); dz (n, r); packed (pairs, r); blocks (count, 2) int: first a and b
 *           of each, a <= b; split s sums blocks s split_blocks .. (s + 1) split_blocks - 1; sums (splits, n, k)
 * numpy twin: clalign.engine.reference.Reference.soft_map_gradient
 */
#include "gpu_tile.cl"

#if TN != 64
#error "TN must be 64: the pairs of a block"
#endif
#define EDGE 8 /* functions along either side of a block */
#define AT_ONCE (4 * SIDE)
#define G_ROW (TN + 1)

#define FETCH_LEFT(values, first)                                                          \
    for (int q = 0; q < LEFTS; ++q) {                                                      \
        const int i = NUMBER(TM, 1, q), t = (first) + STEP(TM, 1, q);                      \
        values[q] = i < rows && t < r ? dz[i * r + t] : ZERO;                              \
    }
#define FETCH_RIGHT(values, first)                                                         \
    for (int q = 0; q < RIGHTS; ++q) {                                                     \
        const int j = NUMBER(TN, 1, q), t = (first) + STEP(TN, 1, q);                      \
        const int a = block_a + j / EDGE, b = block_b + j % EDGE;                          \
        values[q] = a <= b && b < k && t < r ? packed[(a * k - a * (a + 1) / 2 + b) * r + t] : ZERO; \
    }

KERNEL void soft_map_gradient(const int n, const int k, const int r, const int count, const int split_blocks,
                              __global const real *restrict c, __global const real *restrict dz,
                              __global const real *restrict packed, __global const int *restrict blocks,
                              __global real *restrict sums)
{
    TILE_LOCAL
    __local real g[AT_ONCE * G_ROW];
    const int row = get_group_id(0) * TM, rows = min(TM, n - row), split = get_group_id(1);
    c += (size_t)row * k;
    dz += (size_t)row * r;
    sums += ((size_t)split * n + row) * k;
    for (int e = item; e < rows * k; e += WG) sums[e] = ZERO;
    const int last = min((split + 1) * split_blocks, count);
    for (int block = split * split_blocks; block < last; ++block) {
        const int block_a = blocks[2 * block], block_b = blocks[2 * block + 1];
        real tile[RM * RN];
        clear(tile);
        TILE_SUM(tile, r, 1, 1)
        #pragma unroll
        for (int part = 0; part < RM / 4; ++part) {
            #pragma unroll
            for (int i = 0; i < 4; ++i)
                #pragma unroll
                for (int j = 0; j < RN; ++j)
                    g[TILE_ROW(i) * G_ROW + TILE_COLUMN(j)] = tile[(4 * part + i) * RN + j];
            barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
            for (int e = item; e < AT_ONCE * 2 * EDGE; e += WG) {
                const int i = e / (2 * EDGE), own = part * AT_ONCE + i, to_b = e / EDGE % 2, at = e % EDGE;
                const int column = (to_b ? block_b : block_a) + at;
                /* Of a block on the diagonal one item adds both parts of a column. */
                if (own >= rows || column >= k || (to_b && block_a == block_b)) continue;
                __global const real *values = c + own * k;
                real sum = ZERO;
                if (!to_b)
                    for (int b = 0; b < EDGE && block_b + b < k; ++b)
                        sum += g[i * G_ROW + at * EDGE + b] * values[block_b + b];
                if (to_b || block_a == block_b)
                    for (int a = 0; a < EDGE && block_a + a < k; ++a)
                        sum += g[i * G_ROW + a * EDGE + at] * values[block_a + a];
                sums[own * k + column] += sum;
            }
            barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        }
    }
}
