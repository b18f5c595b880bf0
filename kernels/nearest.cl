/* Best point for every query:
 *
 *     index[i] = argmax_j  q_i . p_j - penalty_j,      score[i] that maximum
 *
 * A tile is given up after CHECK_STEPS, 2 CHECK_STEPS, ... steps of its depth if none of its scores can reach the best of its
 * row any more: by Cauchy-Schwarz what is missing of q.p is at most |q'| |p'|, the norms of the components still to come,
 * the tails. Both norms are enlarged so that their product covers the rounding errors of the sums too; so nothing that
 * would win is given up, and index and score are, bit by bit, those of the full search.
 *
 * A row's threshold is its best score so far, or that of a guessed point, lowered by its rounding error: the better the
 * guess, the sooner tiles are given up. It is there to be reached, and is no result.
 *
 * nearest: launch (ceil(row groups / GROUPS)); queries (m, depth); points packed by pack_panels (panels, depth, W); penalty
 *          (panels, W), padded so that lanes beyond p never win; checks: how often a tile may be given up; query_norms
 *          (checks, RT row groups), point_norms (panels, checks, W); guessed (RT row groups) or NULL; index (m) int,
 *          score (m)
 * guessed_thresholds: launch (RT row groups); guess (m) int, one outside 0 .. p - 1 is none; thresholds (RT row groups)
 * query_tail_norms: launch (RT row groups): the enlarged norms of a query's components from (b + 1) CHECK_STEPS on,
 *          b < checks
 * point_tail_norms: launch (panels): the same of the points of a panel
 * pad_penalty: launch (panels W); penalty (p) or NULL to padded (panels, W)
 * numpy twin: clalign.engine.reference.Reference.nearest
 */
#include "best.cl"

#ifndef CHECK_STEPS
#error "CHECK_STEPS must be given: the steps between two checks"
#endif
#ifndef TRIAL
#define TRIAL 32 /* panels after which checks stop, if tiles were given up too seldom or too late to pay for them */
#endif
#if PRECISION == 64
#define ROUNDING ((real)1 / ((integer)1 << 52))
#else
#define ROUNDING ((real)1 / ((integer)1 << 23))
#endif

#define SCORE(product, bias) ((product) - (bias))

#define MAY_WIN(i)                                                     \
    active |= (p##i + row_norms[i] * norm0 >= low0 + row_thresholds[i]) \
              | (q##i + row_norms[i] * norm1 >= low1 + row_thresholds[i]);

#define RAISE(i)                                                                        \
    {                                                                                   \
        const realv one = best[(2 * RT) * group + 2 * i], two = best[(2 * RT) * group + 2 * i + 1]; \
        const realv larger = one > two ? one : two;                                     \
        const real *lanes = (const real *)&larger;                                      \
        real largest = thresholds[group * RT + i];                                      \
        for (int lane = 0; lane < V; ++lane) largest = lanes[lane] > largest ? lanes[lane] : largest; \
        thresholds[group * RT + i] = largest;                                           \
    }

INLINE int any_lane(const intv flags)
{
    const integer *lanes = (const integer *)&flags;
    integer found = 0;
    for (int lane = 0; lane < V; ++lane) found |= lanes[lane];
    return found != 0;
}

#define ADD_SQUARES                                                       \
    {                                                                     \
        const realv left = LOAD(__global, points + (size_t)(t - 1) * W);  \
        const realv right = LOAD(__global, points + (size_t)(t - 1) * W + V); \
        sum0 += left * left;                                              \
        sum1 += right * right;                                            \
    }

/* A penalty made smaller by its rounding error. */
INLINE realv lowered(const realv bias)
{
    return bias * (bias > 0 ? (realv)(ONE - 4 * ROUNDING) : (realv)(ONE + 4 * ROUNDING));
}

KERNEL void nearest(const int m, const int p, const int depth, const int checks, __global const real *restrict queries,
                    __global const real *restrict points, __global const real *restrict penalty,
                    __global const real *restrict query_norms, __global const real *restrict point_norms,
                    __global const real *restrict guessed, __global int *restrict index,
                    __global real *restrict score)
{
    const int row_begin = get_global_id(0) * GROUPS * RT;
    if (row_begin >= m) return;
    const int rows = min(GROUPS * RT, m - row_begin), groups = (rows + RT - 1) / RT;
    const int panels = (p + W - 1) / W, row_count = (m + RT - 1) / RT * RT;
    realv best[GROUPS * RT * 2];
    intv where[GROUPS * RT * 2];
    real thresholds[GROUPS * RT];
    for (int i = 0; i < groups * RT * 2; ++i) {
        best[i] = -INFINITY;
        where[i] = 0;
    }
    for (int i = 0; i < groups * RT; ++i) thresholds[i] = guessed ? guessed[row_begin + i] : -INFINITY;
    int checked = checks, saved = 0;
    for (int panel = 0; panel < panels; ++panel) {
        if (panel % TRIAL == 0) {
            if (panel > 0 && saved * 16 < TRIAL * groups * checks) checked = 0;
            saved = 0;
        }
        const realv bias0 = LOAD(__global, penalty + panel * W), bias1 = LOAD(__global, penalty + panel * W + V);
        const realv low0 = lowered(bias0), low1 = lowered(bias1);
        __global const real *columns_of = points + (size_t)panel * W * depth;
        for (int group = 0; group < groups; ++group) {
            const int first_row = row_begin + group * RT;
            __global const real *scalars_of = queries + (size_t)first_row * depth;
            __global const real *panel_norms = point_norms + (size_t)panel * checks * W;
            const real *row_thresholds = thresholds + group * RT;
            int steps = 0, check = 0;
            TILE_BEGIN(depth, rows - group * RT)
            for (; check < checked; ++check) {
                TILE_STEPS(__global, columns_of + (size_t)steps * W, W, scalars_of + steps, 1, CHECK_STEPS)
                steps += CHECK_STEPS;
                __global const real *row_norms = query_norms + (size_t)check * row_count + first_row;
                const realv norm0 = LOAD(__global, panel_norms), norm1 = LOAD(__global, panel_norms + V);
                panel_norms += W;
                intv active = 0;
                EACH(MAY_WIN)
                if (!any_lane(active)) break;
            }
            if (check < checked) {
                saved += checked - check;
                continue;
            }
            TILE_STEPS(__global, columns_of + (size_t)steps * W, W, scalars_of + steps, 1, depth - steps)
            EACH(KEEP_ROW)
            if (checked) {
                EACH(RAISE)
            }
        }
    }
    write_best(rows, best, where, index + row_begin, score + row_begin);
}

KERNEL void pad_penalty(const int p, const int count, __global const real *restrict penalty, __global real *restrict padded)
{
    const int j = get_global_id(0);
    if (j >= count) return;
    padded[j] = j < p ? (penalty ? penalty[j] : ZERO) : INFINITY;
}

KERNEL void guessed_thresholds(const int m, const int p, const int depth, __global const real *restrict queries,
                               __global const real *restrict points, __global const real *restrict penalty,
                               __global const int *restrict guess, __global real *restrict thresholds)
{
    const int i = get_global_id(0), row_count = (m + RT - 1) / RT * RT;
    if (i >= row_count) return;
    const int row = min(i, m - 1), j = guess[row];
    if (j < 0 || j >= p) {
        thresholds[i] = -INFINITY;
        return;
    }
    queries += (size_t)row * depth;
    points += (size_t)(j / W) * W * depth + j % W;
    real product = ZERO, query = ZERO, point = ZERO;
    for (int t = 0; t < depth; ++t) {
        const real a = queries[t], b = points[(size_t)t * W];
        product += a * b;
        query += a * a;
        point += b * b;
    }
    const real margin = sqrt(query * point) * (real)(depth + 4) + 4 * fabs(penalty[j]);
    thresholds[i] = product - penalty[j] - 2 * ROUNDING * margin;
}

KERNEL void query_tail_norms(const int m, const int depth, const int checks, __global const real *restrict queries,
                             __global real *restrict norms)
{
    const int i = get_global_id(0), row_count = (m + RT - 1) / RT * RT;
    if (i >= row_count) return;
    queries += (size_t)min(i, m - 1) * depth;
    real sum = ZERO;
    int t = depth;
    for (int check = checks - 1; check >= 0; --check) {
        for (; t > (check + 1) * CHECK_STEPS; --t) sum += queries[t - 1] * queries[t - 1];
        norms[(size_t)check * row_count + i] = sqrt(sum);
    }
    for (; t > 0; --t) sum += queries[t - 1] * queries[t - 1];
    const real margin = sqrt(sum * (real)(depth + 4) * ROUNDING);
    for (int check = 0; check < checks; ++check) norms[(size_t)check * row_count + i] += margin;
}

KERNEL void point_tail_norms(const int panels, const int depth, const int checks, __global const real *restrict points,
                             __global real *restrict norms)
{
    const int panel = get_global_id(0);
    if (panel >= panels) return;
    points += (size_t)panel * depth * W;
    norms += (size_t)panel * checks * W;
    realv sum0 = 0, sum1 = 0;
    int t = depth;
    for (int check = checks - 1; check >= 0; --check) {
        for (; t > (check + 1) * CHECK_STEPS; --t) ADD_SQUARES
        STORE(__global, norms + check * W, sqrt(sum0));
        STORE(__global, norms + check * W + V, sqrt(sum1));
    }
    for (; t > 0; --t) ADD_SQUARES
    const realv margin0 = sqrt(sum0 * ((real)(depth + 4) * ROUNDING)), margin1 = sqrt(sum1 * ((real)(depth + 4) * ROUNDING));
    for (int check = 0; check < checks; ++check) {
        __global real *to = norms + check * W;
        STORE(__global, to, LOAD(__global, to) + margin0);
        STORE(__global, to + V, LOAD(__global, to + V) + margin1);
    }
}
