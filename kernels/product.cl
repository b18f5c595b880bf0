/* Dense and banded products: C (m, n) = scale * A (m, depth) B (depth, n), added to C when accumulate is set.
 *
 * One work-item owns `groups` x `panels` tiles of RT x W entries of C and runs over the depth in blocks of KB, so that one
 * panel of B and the rows of A stay in the first cache. A is read through the strides of a row group, a row and a step,
 * which covers row-major A, its transpose and A packed by pack_tiles; B through the strides of a row and of a panel, which
 * covers row-major B and B packed by pack_panels.
 * The order of summation does not depend on the launch, so results are bitwise reproducible.
 *
 * product:     launch (ceil(row groups / groups), ceil(column panels / panels)); a, b reals; c (m, n); each (*, 2) int or
 *              NULL, first and last + 1: left_depths (row groups) and right_depths (column panels), the depth with anything
 *              in them; kept (column panels), the rows of C that are wanted of that panel
 * pack_panels: launch (column panels, ceil(depth / DP)); out (column panels, depth, W) = b[t b_row + j b_column], zero
 *              beyond column n
 * pack_tiles:  launch (tiles, ceil(depth / DP)); out (tiles, depth, RT) = weight[t] b[t, j] for row-major b
 *              (depth, n); weight (depth) or NULL; columns beyond n are of no meaning
 * numpy twins: clalign.engine.reference.Reference.product, banded_product
 */
#include "tile.cl"

#ifndef KB
#define KB 256 /* depth of a block */
#endif
#ifndef DP
#define DP 512 /* depth that one work-item packs */
#endif

#define WRITE(i)                                                    \
    if (i < rows) {                                                 \
        __global real *to = target + (size_t)i * n;                 \
        p##i *= scale;                                              \
        q##i *= scale;                                              \
        if (width >= W) {                                           \
            if (add) {                                              \
                p##i += LOAD(__global, to);                         \
                q##i += LOAD(__global, to + V);                     \
            }                                                       \
            STORE(__global, to, p##i);                              \
            STORE(__global, to + V, q##i);                          \
        } else {                                                    \
            real line[W];                                           \
            STORE(__private, line, p##i);                           \
            STORE(__private, line + V, q##i);                       \
            int j = 0;                                              \
            if (width >= V) {                                       \
                if (add) p##i += LOAD(__global, to);                \
                STORE(__global, to, p##i);                          \
                j = V;                                              \
            }                                                       \
            for (; j < width; ++j) to[j] = add ? to[j] + line[j] : line[j]; \
        }                                                           \
    }

/* Fetch the next rows of a tall A, which come from memory one group after the other, while this group is summed. */
INLINE void fetch_rows(__global const real *rows, const int row_stride, const int count)
{
    for (int i = 0; i < RT; ++i)
        for (int t = 0; t < count; t += LINE) PREFETCH(rows + (size_t)i * row_stride + t, 0);
}

KERNEL void product(const int m, const int n, const int depth, const int groups, const int panels,
                    const real scale, const int accumulate, __global const real *restrict a, const long a_group,
                    const int a_row, const int a_step, __global const real *restrict b, const int b_step, const long b_panel,
                    __global const int *restrict left_depths, __global const int *restrict right_depths,
                    __global const int *restrict kept, __global real *restrict c)
{
    const int group_count = (m + RT - 1) / RT, panel_count = (n + W - 1) / W;
    const int group_begin = get_global_id(0) * groups, panel_begin = get_global_id(1) * panels;
    const int group_end = min(group_begin + groups, group_count), panel_end = min(panel_begin + panels, panel_count);
    for (int block = 0; block < depth; block += KB)
        for (int panel = panel_begin; panel < panel_end; ++panel) {
            const int panel_first = max(block, right_depths ? right_depths[2 * panel] : 0);
            const int panel_last = min(min(block + KB, depth), right_depths ? right_depths[2 * panel + 1] : depth);
            const int add = accumulate || block > 0;
            const int width = n - panel * W;
            const int kept_begin = kept ? max(group_begin, kept[2 * panel] / RT) : group_begin;
            const int kept_end = kept ? min(group_end, (kept[2 * panel + 1] + RT - 1) / RT) : group_end;
            for (int group = kept_begin; group < kept_end; ++group) {
                const int first = left_depths ? max(panel_first, left_depths[2 * group]) : panel_first;
                const int last = left_depths ? min(panel_last, left_depths[2 * group + 1]) : panel_last;
                if (first >= last && add) continue;
                const int rows = min(RT, m - group * RT);
                TILE_BEGIN(a_row, rows)
                __global const real *from_a = a + group * a_group + (size_t)first * a_step;
                __global const real *from_b = b + panel * b_panel + (size_t)first * b_step;
                __global real *target = c + (size_t)group * RT * n + panel * W;
                if (panel == panel_begin && a_step == 1) fetch_rows(from_a + a_group, a_row, last - first);
                for (int i = 0; i < rows; ++i) {
                    PREFETCH(target + (size_t)i * n, 1);
                    PREFETCH(target + (size_t)i * n + V, 1);
                }
                if (width > V)
                    TILE_STEPS(__global, from_b, b_step, from_a, a_step, last - first)
                else
                    TILE_HALF_STEPS(__global, from_b, b_step, from_a, a_step, last - first)
                EACH(WRITE)
            }
        }
}

KERNEL void pack_panels(const int n, const int depth, __global const real *restrict b, const int b_row, const int b_column,
                        __global real *restrict out)
{
    const int panel = get_global_id(0);
    if (panel * W >= n) return;
    const int width = min(W, n - panel * W);
    const int begin = get_global_id(1) * DP, end = min(begin + DP, depth);
    b += (size_t)panel * W * b_column;
    out += (size_t)panel * W * depth;
    if (b_column == 1 && width == W) {
        for (int t = begin; t < end; ++t) {
            STORE(__global, out + (size_t)t * W, LOAD(__global, b + (size_t)t * b_row));
            STORE(__global, out + (size_t)t * W + V, LOAD(__global, b + (size_t)t * b_row + V));
        }
        return;
    }
    for (int t = begin; t < end; ++t) {
        for (int j = 0; j < width; ++j) out[(size_t)t * W + j] = b[(size_t)t * b_row + (size_t)j * b_column];
        for (int j = width; j < W; ++j) out[(size_t)t * W + j] = ZERO;
    }
}

KERNEL void pack_tiles(const int n, const int depth, __global const real *restrict b,
                       __global const real *restrict weight, __global real *restrict out)
{
    const int tile = get_global_id(0);
    if (tile * RT >= n) return;
    const int last = min(RT, n - tile * RT) - 1;
    const int begin = get_global_id(1) * DP, end = min(begin + DP, depth);
    b += (size_t)tile * RT;
    out += (size_t)tile * RT * depth;
    int t = begin;
    if (last == RT - 1)
        /* Whole vectors: what they write too much is overwritten by the next rows, so the last ones are left to the loop. */
        for (; t + (V - 1) / RT < end - 1; ++t) {
            const real factor = weight ? weight[t] : ONE;
            STORE(__global, out + (size_t)t * RT, factor * LOAD(__global, b + (size_t)t * n));
#if RT > V
            for (int j = V; j < RT; ++j) out[(size_t)t * RT + j] = factor * b[(size_t)t * n + j];
#endif
        }
    for (; t < end; ++t) {
        const real factor = weight ? weight[t] : ONE;
        /* Columns beyond the matrix repeat the last one: nobody reads their sums. */
        for (int j = 0; j < RT; ++j) out[(size_t)t * RT + j] = factor * b[(size_t)t * n + min(j, last)];
    }
}
