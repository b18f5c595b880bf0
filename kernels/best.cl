/* The epilogue of a product of which only the best entry of every row is wanted: the (m, p) scores are never stored.
 *
 * For every row and lane, `best` holds the largest score so far and `where` the panel that it was in. Panels go in
 * ascending order and only a larger score replaces, and the lanes of a row are compared at the end: ties go to the lowest
 * index. A file that includes this one defines SCORE(product, bias), and `bias0`, `bias1`, `panel` and `group` where it keeps.
 *
 * No kernels of its own: best and where (GROUPS row groups, RT, 2) vectors in private memory, index (rows) int and score
 * (rows) in global memory; numpy twins: clalign.engine.reference.Reference.nearest, soft_map_argmax
 */
#include "tile.cl"

#ifndef GROUPS
#define GROUPS 8 /* row groups of one work-item: their best scores stay in the first cache */
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

INLINE void write_best(const int rows, const realv *best, const intv *where, __global int *index, __global real *score)
{
    for (int i = 0; i < rows; ++i) {
        const real *scores = (const real *)(best + 2 * i);
        const integer *at = (const integer *)(where + 2 * i);
        real largest = scores[0];
        int found = at[0] * W;
        for (int lane = 1; lane < W; ++lane) {
            const int candidate = at[lane] * W + lane;
            if (scores[lane] > largest || (scores[lane] == largest && candidate < found)) {
                largest = scores[lane];
                found = candidate;
            }
        }
        index[i] = found;
        score[i] = largest;
    }
}
