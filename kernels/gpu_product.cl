/* Dense and banded products, and Gram matrices, for the class of GPUs:
 *
 *     C (m, n) = scale * sum over t of left(i, t) weight(t) right(t, j), added to C when accumulate is set
 *
 * A work-group owns a tile of TM x TN entries of C and a split of the depth. Either side is read through its strides, so any of
 * them may be transposed; neighbouring items read along whichever stride is one.
 *
 * product: launch (row tiles WG, column tiles, splits); a, b: element (i, t) of the left side at i a_row + t a_step, (t, j) of
 *          the right one at t b_step + j b_column; weight (depth) or NULL; left_depths (row tiles, 2) and right_depths (column
 *          tiles, 2) int or NULL, first and last + 1 step with anything in them; kept (column tiles, 2) int or NULL, the rows
 *          of C that are wanted of those columns; symmetric: tiles below the diagonal are left out; c (splits, m, n), split s
 *          sums depth s split_depth .. (s + 1) split_depth - 1
 * numpy twins: clalign.engine.reference.Reference.product, banded_product, weighted_gram
 */
#include "gpu_tile.cl"

#define FETCH_LEFT(values, first)                                                                        \
    for (int q = 0; q < LEFTS; ++q) {                                                  \
        const int i = NUMBER(TM, a_along, q), t = (first) + STEP(TM, a_along, q);                        \
        values[q] = i < rows && t < depth_here ? a[i * a_row + t * a_step] * (weight ? weight[t] : ONE) : ZERO; \
    }
#define FETCH_RIGHT(values, first)                                                                       \
    for (int q = 0; q < RIGHTS; ++q) {                                                 \
        const int j = NUMBER(TN, b_along, q), t = (first) + STEP(TN, b_along, q);                        \
        values[q] = j < columns && t < depth_here ? b[t * b_step + j * b_column] : ZERO;                 \
    }

KERNEL void product(const int m, const int n, const int depth, const int split_depth, const real scale, const int accumulate,
                    const int symmetric, __global const real *restrict a, const int a_row, const int a_step,
                    __global const real *restrict weight, __global const real *restrict b, const int b_step,
                    const int b_column, __global const int *restrict left_depths, __global const int *restrict right_depths,
                    __global const int *restrict kept, __global real *restrict c)
{
    TILE_LOCAL
    const int row_tile = get_group_id(0), column_tile = get_group_id(1), split = get_group_id(2);
    const int row = row_tile * TM, column = column_tile * TN, columns = n - column;
    /* A tile that nobody reads has no rows and no depth: items must not leave before the others of their group. */
    const int wanted = !(symmetric && column + TN <= row) &&
                       !(kept && (kept[2 * column_tile + 1] <= row || kept[2 * column_tile] >= row + TM));
    const int rows = wanted ? m - row : 0;
    int first = split * split_depth, last = min(depth, first + split_depth);
    if (left_depths) {
        first = max(first, left_depths[2 * row_tile]);
        last = min(last, left_depths[2 * row_tile + 1]);
    }
    if (right_depths) {
        first = max(first, right_depths[2 * column_tile]);
        last = min(last, right_depths[2 * column_tile + 1]);
    }
    const int depth_here = wanted ? max(last - first, 0) : 0, a_along = a_step == 1, b_along = b_column != 1;
    a += (size_t)row * a_row + (size_t)first * a_step;
    b += (size_t)first * b_step + (size_t)column * b_column;
    if (weight) weight += first;
    c += ((size_t)split * m + row) * n + column;
    real tile[RM * RN], total[RM * RN];
    clear(tile);
    clear(total);
    TILE_SUM_OF_PARTS(total, tile, depth_here, a_along, b_along)
    #pragma unroll
    for (int e = 0; e < RM * RN; ++e) total[e] *= scale;
    store_tile(total, rows, columns, n, accumulate, c);
}
