/* Gram matrices C (m, n) = A^T diag(weight) B of A (depth, m) and B (depth, n), depth >> m, n, for devices of a class whose
 * work-items each have a cache.
 *
 * One work-item owns one part of the rows of C and one split of the depth, over which it goes in blocks of KB: it packs
 * the block of B in panels and each tile of columns of A just before they are used, so both stay in its caches. Sums are
 * collected in tiles and added up afterwards, in an order that does not depend on the launch: bitwise reproducible.
 * When `symmetric` is set (A is B), tiles below the diagonal are left out and mirrored at the end.
 *
 * gram:        launch (parts, splits); part q owns row groups q groups .. (q + 1) groups - 1, split s sums depth
 *              s split_depth .. (s + 1) split_depth - 1; a (depth, m); b (depth, n); weight (depth) or NULL;
 *              packed (splits, parts, (column panels W + RT) KB) scratch; partial (splits, row groups, column panels, RT, W)
 * gather_gram: launch (row groups): c (m, n) = sum over splits of partial; when `transposed` is set its transpose, c (n, m)
 * numpy twin: clalign.engine.reference.Reference.weighted_gram
 */
#include "tile.cl"

#ifndef KB
#define KB 128 /* depth of a block */
#endif

/* Is any column of the panel on or above the diagonal in a row of the group? */
#define REACHES(group, panel) ((panel + 1) * W > (group) * RT)

INLINE void pack_right(const int first, const int count, const int n, __global const real *b, __global const real *weight,
                       __global real *out)
{
    /* Columns beyond n are whatever follows in memory: nobody reads their sums. */
    for (int column = 0; column < n; column += W, out += KB * W) {
        __global const real *from = b + (size_t)first * n + column;
        for (int t = 0; t < count; ++t, from += n) {
            const real factor = weight ? weight[first + t] : ONE;
            STORE(__global, out + t * W, factor * LOAD(__global, from));
            STORE(__global, out + t * W + V, factor * LOAD(__global, from + V));
        }
    }
}

INLINE void pack_left(const int first, const int count, const int m, const int column, __global const real *a,
                      __global real *out)
{
    const int width = min(RT, m - column);
    __global const real *from = a + (size_t)first * m + column;
    if (width == RT)
        for (int t = 0; t < count; ++t)
            for (int i = 0; i < RT; ++i) out[t * RT + i] = from[(size_t)t * m + i];
    else
        for (int t = 0; t < count; ++t)
            for (int i = 0; i < RT; ++i) out[t * RT + i] = from[(size_t)t * m + min(i, width - 1)];
}

KERNEL void gram(const int m, const int n, const int depth, const int parts, const int groups, const int split_depth,
                 const int symmetric, __global const real *restrict a, __global const real *restrict b,
                 __global const real *restrict weight, __global real *restrict packed, __global real *restrict partial)
{
    const int part = get_global_id(0), split = get_global_id(1);
    if (part >= parts) return;
    const int group_count = (m + RT - 1) / RT, panel_count = (n + W - 1) / W;
    const int group_begin = part * groups, group_end = min(group_begin + groups, group_count);
    const int from = split * split_depth, to = min(depth, from + split_depth);
    __global real *right = packed + (size_t)(split * parts + part) * (panel_count * W + RT) * KB;
    __global real *left = right + (size_t)panel_count * W * KB;
    partial += (size_t)split * group_count * panel_count * RT * W;
    for (int block = from; block < to; block += KB) {
        const int count = min(KB, to - block), fresh = block == from;
        pack_right(block, count, n, b, weight, right);
        for (int group = group_begin; group < group_end; ++group) {
            pack_left(block, count, m, group * RT, a, left);
            for (int panel = 0; panel < panel_count; ++panel) {
                if (symmetric && !REACHES(group, panel)) continue;
                __global real *sums = partial + ((size_t)group * panel_count + panel) * RT * W;
                __global const real *columns_of = right + (size_t)panel * W * KB;
                TILE_BEGIN(1, RT)
                if (n - panel * W > V)
                    TILE_STEPS(__global, columns_of, W, left, RT, count)
                else
                    TILE_HALF_STEPS(__global, columns_of, W, left, RT, count)
                EACH(COLLECT)
            }
        }
    }
}

KERNEL void gather_gram(const int m, const int n, const int splits, const int symmetric,
                        const int transposed, __global const real *restrict partial, __global real *restrict c)
{
    const int group = get_global_id(0), group_count = (m + RT - 1) / RT, panel_count = (n + W - 1) / W;
    if (group >= group_count) return;
    const size_t stride = (size_t)group_count * panel_count * RT * W;
    for (int panel = 0; panel < panel_count; ++panel) {
        if (symmetric && !REACHES(group, panel)) continue;
        const int width = min(W, n - panel * W);
        for (int i = 0; i < min(RT, m - group * RT); ++i) {
            __global const real *from = partial + (((size_t)group * panel_count + panel) * RT + i) * W;
            const int row = group * RT + i;
            realv sum0 = 0, sum1 = 0;
            for (int split = 0; split < splits; ++split) {
                sum0 += LOAD(__global, from + split * stride);
                sum1 += LOAD(__global, from + split * stride + V);
            }
            __global real *to = c + (size_t)row * n + panel * W;
            if (width == W && !symmetric && !transposed) {
                STORE(__global, to, sum0);
                STORE(__global, to + V, sum1);
                continue;
            }
            real line[W];
            STORE(__private, line, sum0);
            STORE(__private, line + V, sum1);
            for (int j = symmetric ? max(0, row - panel * W) : 0; j < width; ++j) {
                if (!transposed) to[j] = line[j];
                if (symmetric || transposed) c[(size_t)(panel * W + j) * m + row] = line[j];
            }
        }
    }
}
