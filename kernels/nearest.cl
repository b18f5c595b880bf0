/* Best point for every query without storing the (m, p) scores:
 *
 *     index[i] = argmax_j  q_i.p_j - penalty_j           (ABSOLUTE 0)
 *     index[i] = argmax_j  penalty_j (q_i.p_j)^2          (ABSOLUTE 1, Eq. 28)
 *
 * A product whose epilogue keeps, for every row and lane, the best score so far and its panel. Panels go in ascending
 * order and only a larger score replaces, so ties end at the lowest index.
 *
 * With ABSOLUTE 0 a tile is given up after b BOUND steps if none of its scores can reach the best of its row any more: by
 * Cauchy-Schwarz what is missing of q.p is at most |q'| |p'|, the norms of the components from b BOUND on. Both norms are
 * enlarged so that their product covers the rounding errors of the sums too; so nothing that would win is given up, and
 * index and score are, bit by bit, those of the full search.
 *
 * The best score of a row starts at minus infinity, or at that of a guessed point, lowered by its rounding error: the
 * better the guess, the sooner tiles are given up. It is a bar to be reached, not a result.
 *
 * nearest: launch (ceil(row groups / NEAREST_GROUPS)); queries (m, depth); points packed by pack_panels
 *          (panels, depth, W); penalty (panels, W), padded so that lanes beyond p never win; checks: how often a tile may be
 *          given up; query_rest (checks, RT row groups), point_rest (panels, checks, W); guessed (RT row groups) or NULL;
 *          index (m) int, score (m)
 * guessed_scores: launch (RT row groups); guess (m) int, one outside 0 .. p - 1 is none; guessed (RT row groups)
 * query_rests: launch (RT row groups): the enlarged norms of a query's components from (b + 1) BOUND on, b < checks
 * point_rests: launch (panels): the same of the points of a panel
 * pad_penalty: launch (panels W); penalty (p) or NULL to padded (panels, W)
 * numpy twin: clalign.engine.reference_search.ReferenceSearches.nearest
 */
#ifndef NEAREST_GROUPS
#define NEAREST_GROUPS 8 /* row groups of one work-item: their best scores stay in the first cache */
#endif
#ifndef ABSOLUTE
#define ABSOLUTE 0
#endif
#ifndef BOUND
#error "BOUND must be given: the steps between two checks"
#endif
#ifndef TRIAL
#define TRIAL 32 /* panels after which checks stop, if tiles were given up too seldom or too late to pay for them */
#endif
#if PRECISION == 64
#define ROUNDING ((real)1 / ((whole)1 << 52))
#else
#define ROUNDING ((real)1 / ((whole)1 << 23))
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

#define MAY_WIN(i)                                                                      \
    alive |= (p##i + rests[i] * rest0 >= low0 + bars[i]) | (q##i + rests[i] * rest1 >= low1 + bars[i]);

#define RAISE(i)                                                                        \
    {                                                                                   \
        const realv one = best[(2 * RT) * group + 2 * i], two = best[(2 * RT) * group + 2 * i + 1]; \
        const realv larger = one > two ? one : two;                                     \
        const real *lanes = (const real *)&larger;                                      \
        real largest = top[group * RT + i];                                             \
        for (int lane = 0; lane < V; ++lane) largest = lanes[lane] > largest ? lanes[lane] : largest; \
        top[group * RT + i] = largest;                                                  \
    }

INLINE int any_lane(const intv flags)
{
    const whole *lanes = (const whole *)&flags;
    whole found = 0;
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
                    __global const real *restrict query_rest, __global const real *restrict point_rest,
                    __global const real *restrict guessed, __global int *restrict index,
                    __global real *restrict score)
{
    const int row_begin = get_global_id(0) * NEAREST_GROUPS * RT;
    if (row_begin >= m) return;
    const int rows = min(NEAREST_GROUPS * RT, m - row_begin), groups = (rows + RT - 1) / RT;
    const int panels = (p + W - 1) / W, row_count = (m + RT - 1) / RT * RT;
    realv best[NEAREST_GROUPS * RT * 2];
    intv where[NEAREST_GROUPS * RT * 2];
    real top[NEAREST_GROUPS * RT];
    for (int i = 0; i < groups * RT * 2; ++i) {
        best[i] = -INFINITY;
        where[i] = 0;
    }
    for (int i = 0; i < groups * RT; ++i) top[i] = guessed ? guessed[row_begin + i] : -INFINITY;
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
            __global const real *panel_rests = point_rest + (size_t)panel * checks * W;
            const real *bars = top + group * RT;
            int steps = 0, check = 0;
            TILE_BEGIN(depth, rows - group * RT)
            for (; check < checked; ++check) {
                TILE_STEPS(__global, columns_of + (size_t)steps * W, W, scalars_of + steps, 1, BOUND)
                steps += BOUND;
                __global const real *rests = query_rest + (size_t)check * row_count + first_row;
                const realv rest0 = LOAD(__global, panel_rests), rest1 = LOAD(__global, panel_rests + V);
                panel_rests += W;
                intv alive = 0;
                EACH(MAY_WIN)
                if (!any_lane(alive)) break;
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

KERNEL void guessed_scores(const int m, const int p, const int depth, __global const real *restrict queries,
                           __global const real *restrict points, __global const real *restrict penalty,
                           __global const int *restrict guess, __global real *restrict guessed)
{
    const int i = get_global_id(0), row_count = (m + RT - 1) / RT * RT;
    if (i >= row_count) return;
    const int row = min(i, m - 1), j = guess[row];
    if (j < 0 || j >= p) {
        guessed[i] = -INFINITY;
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
    guessed[i] = product - penalty[j] - 2 * ROUNDING * margin;
}

KERNEL void query_rests(const int m, const int depth, const int checks, __global const real *restrict queries,
                        __global real *restrict rests)
{
    const int i = get_global_id(0), row_count = (m + RT - 1) / RT * RT;
    if (i >= row_count) return;
    queries += (size_t)min(i, m - 1) * depth;
    real sum = ZERO;
    int t = depth;
    for (int check = checks - 1; check >= 0; --check) {
        for (; t > (check + 1) * BOUND; --t) sum += queries[t - 1] * queries[t - 1];
        rests[(size_t)check * row_count + i] = sqrt(sum);
    }
    for (; t > 0; --t) sum += queries[t - 1] * queries[t - 1];
    const real margin = sqrt(sum * (real)(depth + 4) * ROUNDING);
    for (int check = 0; check < checks; ++check) rests[(size_t)check * row_count + i] += margin;
}

KERNEL void point_rests(const int panels, const int depth, const int checks, __global const real *restrict points,
                        __global real *restrict rests)
{
    const int panel = get_global_id(0);
    if (panel >= panels) return;
    points += (size_t)panel * depth * W;
    rests += (size_t)panel * checks * W;
    realv sum0 = 0, sum1 = 0;
    int t = depth;
    for (int check = checks - 1; check >= 0; --check) {
        for (; t > (check + 1) * BOUND; --t) ADD_SQUARES
        STORE(__global, rests + check * W, sqrt(sum0));
        STORE(__global, rests + check * W + V, sqrt(sum1));
    }
    for (; t > 0; --t) ADD_SQUARES
    const realv margin0 = sqrt(sum0 * ((real)(depth + 4) * ROUNDING)), margin1 = sqrt(sum1 * ((real)(depth + 4) * ROUNDING));
    for (int check = 0; check < checks; ++check) {
        __global real *to = rests + check * W;
        STORE(__global, to, LOAD(__global, to) + margin0);
        STORE(__global, to + V, LOAD(__global, to + V) + margin1);
    }
}
