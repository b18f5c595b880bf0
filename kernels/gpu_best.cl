/* Best point of every row for the class of GPUs: the nearest point, or the hard map of a soft one (Eq. 16, 28)
 *
 *     index[i] = argmax_j  score(q_i . p_j, bias_j),      score[i] that maximum
 *     score(x, y) = x - y, bias the penalty;      with -D SQUARED=1  y x^2, bias the weight
 *
 * The tile of a product whose scores are never stored: an item keeps the best of each of its rows over all tiles of points of its
 * split, its columns in ascending order and only a larger score replacing; ties between items, and between splits, go to the
 * lower index. So do they in the whole.
 *
 * best:        launch (row tiles WG, splits); queries (m, depth); points (p, depth); bias (p) or NULL for zeros; split s looks at
 *              tiles s split_tiles .. (s + 1) split_tiles - 1 of points; index (splits, m) int, score (splits, m)
 * finish_best: launch (m): best of the splits; indices (splits, m) int, scores (splits, m); index (m) int, score (m)
 * numpy twins: clalign.engine.reference.Reference.nearest, soft_map_argmax
 */
#include "gpu_tile.cl"

#ifndef SQUARED
#define SQUARED 0
#endif
#if SQUARED
#define SCORE(product, level) ((level) * (product) * (product))
#else
#define SCORE(product, level) ((product) - (level))
#endif

#define FETCH_LEFT(values, first)                                                         \
    for (int q = 0; q < LEFTS; ++q) {                                                     \
        const int i = NUMBER(TM, 1, q), t = (first) + STEP(TM, 1, q);                     \
        values[q] = i < rows && t < depth ? queries[i * depth + t] : ZERO;                \
    }
#define FETCH_RIGHT(values, first)                                                        \
    for (int q = 0; q < RIGHTS; ++q) {                                                    \
        const int j = NUMBER(TN, 1, q), t = (first) + STEP(TN, 1, q);                     \
        values[q] = j < count && t < depth ? among[j * depth + t] : ZERO;                 \
    }

KERNEL void best(const int m, const int p, const int depth, const int split_tiles, __global const real *restrict queries,
                 __global const real *restrict points, __global const real *restrict bias, __global int *restrict index,
                 __global real *restrict score)
{
    TILE_LOCAL
    __local real scores[TM * SIDE];
    __local int indices[TM * SIDE];
    const int row = get_group_id(0) * TM, rows = m - row, split = get_group_id(1);
    queries += (size_t)row * depth;
    const int begin = split * split_tiles * TN, end = min(begin + split_tiles * TN, p);
    real largest[RM];
    int found[RM];
    #pragma unroll
    for (int i = 0; i < RM; ++i) {
        largest[i] = -INFINITY;
        found[i] = begin;
    }
    for (int first_point = begin; first_point < end; first_point += TN) {
        const int count = end - first_point;
        __global const real *among = points + (size_t)first_point * depth;
        real tile[RM * RN];
        clear(tile);
        TILE_SUM(tile, depth, 1, 1)
        #pragma unroll
        for (int j = 0; j < RN; ++j) {
            const int point = first_point + TILE_COLUMN(j);
            if (point < end) {
                const real level = bias ? bias[point] : ZERO;
                #pragma unroll
                for (int i = 0; i < RM; ++i) {
                    const real fresh = SCORE(tile[i * RN + j], level);
                    const int better = fresh > largest[i];
                    largest[i] = better ? fresh : largest[i];
                    found[i] = better ? point : found[i];
                }
            }
        }
    }
    #pragma unroll
    for (int i = 0; i < RM; ++i) {
        scores[TILE_ROW(i) * SIDE + item % SIDE] = largest[i];
        indices[TILE_ROW(i) * SIDE + item % SIDE] = found[i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item >= min(TM, rows)) return;
    real best_score = scores[item * SIDE];
    int best_index = indices[item * SIDE];
    for (int e = item * SIDE + 1; e < (item + 1) * SIDE; ++e)
        if (scores[e] > best_score || (scores[e] == best_score && indices[e] < best_index)) {
            best_score = scores[e];
            best_index = indices[e];
        }
    index[(size_t)split * m + row + item] = best_index;
    score[(size_t)split * m + row + item] = best_score;
}

KERNEL void finish_best(const int m, const int splits, __global const int *restrict indices,
                        __global const real *restrict scores, __global int *restrict index, __global real *restrict score)
{
    const int i = get_global_id(0);
    if (i >= m) return;
    real best_score = scores[i];
    int best_index = indices[i];
    for (int e = i + m; e < splits * m; e += m)
        if (scores[e] > best_score) {
            best_score = scores[e];
            best_index = indices[e];
        }
    index[i] = best_index;
    score[i] = best_score;
}
