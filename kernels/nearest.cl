/* Best point for every query without storing the (m, p) scores:
 *
 *     index[i] = argmax_j  q_i.p_j - penalty_j           (ABSOLUTE 0)
 *     index[i] = argmax_j  penalty_j (q_i.p_j)^2          (ABSOLUTE 1, Eq. 28)
 *
 * A product whose epilogue keeps, for every row and lane, the best score so far and its panel. Panels go in ascending
 * order and only a larger score replaces, so ties end at the lowest index.
 *
 * nearest: launch (ceil(row groups / NEAREST_GROUPS)); queries (m, depth); points packed by pack_panels
 *          (panels, depth, W); penalty (panels, W), padded so that lanes beyond p never win; index (m) int, score (m)
 * pad_penalty: launch (panels W); penalty (p) or NULL to padded (panels, W)
 * numpy twin: clalign.engine.reference_search.ReferenceSearches.nearest
 */
#ifndef NEAREST_GROUPS
#define NEAREST_GROUPS 8 /* row groups of one work-item: their best scores stay in the first cache */
#endif
#ifndef ABSOLUTE
#define ABSOLUTE 0
#endif

#if ABSOLUTE
#define SCORE(value, bias) ((bias) * (value) * (value))
#else
#define SCORE(value, bias) ((value) - (bias))
#endif

#define KEEP(slot, value, bias)                              \
    {                                                        \
        const realv fresh = SCORE(value, bias);              \
        const intv better = fresh > best[slot];              \
        best[slot] = better ? fresh : best[slot];            \
        where[slot] = better ? (intv)(panel) : where[slot];  \
    }

#define KEEP_ROW(i)                                          \
    KEEP((2 * RT) * group + 2 * i, p##i, bias0)              \
    KEEP((2 * RT) * group + 2 * i + 1, q##i, bias1)

KERNEL void nearest(const int m, const int p, const int depth, __global const real *restrict queries,
                    __global const real *restrict points, __global const real *restrict penalty,
                    __global int *restrict index, __global real *restrict score)
{
    const int row_begin = get_global_id(0) * NEAREST_GROUPS * RT;
    if (row_begin >= m) return;
    const int rows = min(NEAREST_GROUPS * RT, m - row_begin), groups = (rows + RT - 1) / RT;
    const int panels = (p + W - 1) / W;
    realv best[NEAREST_GROUPS * RT * 2];
    intv where[NEAREST_GROUPS * RT * 2];
    for (int i = 0; i < groups * RT * 2; ++i) {
        best[i] = -INFINITY;
        where[i] = 0;
    }
    for (int panel = 0; panel < panels; ++panel) {
        const realv bias0 = LOAD(__global, penalty + panel * W), bias1 = LOAD(__global, penalty + panel * W + V);
        for (int group = 0; group < groups; ++group) {
            TILE_BEGIN(depth, rows - group * RT)
            TILE_STEPS(__global, points + (size_t)panel * W * depth, W,
                       queries + (size_t)(row_begin + group * RT) * depth, 1, depth)
            EACH(KEEP_ROW)
        }
    }
    for (int i = 0; i < rows; ++i) {
        const real *scores = (const real *)(best + 2 * i);
        const whole *at = (const whole *)(where + 2 * i);
        real top = scores[0];
        int found = at[0] * W;
        for (int lane = 1; lane < W; ++lane) {
            const int candidate = at[lane] * W + lane;
            if (scores[lane] > top || (scores[lane] == top && candidate < found)) {
                top = scores[lane];
                found = candidate;
            }
        }
        index[row_begin + i] = found;
        score[row_begin + i] = top;
    }
}

KERNEL void pad_penalty(const int p, const int count, __global const real *restrict penalty, __global real *restrict padded)
{
    const int j = get_global_id(0);
    if (j >= count) return;
#if ABSOLUTE
    padded[j] = j < p ? (penalty ? penalty[j] : ONE) : -ONE;
#else
    padded[j] = j < p ? (penalty ? penalty[j] : ZERO) : INFINITY;
#endif
}
