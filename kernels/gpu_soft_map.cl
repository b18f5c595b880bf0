/* The soft map as a quadratic form, and the packed moments that it reads, for the class of GPUs (Eq. 15, 27):
 *
 *     sums[j, r]        = sum over pairs a <= b of c[j, a] c[j, b] packed[(a, b), r]
 *     packed[(a, b), r] = (a == b ? 1 : 2) * sum over i of psi[i, a] psi[i, b] w[i] u[i, r],      a <= b
 *
 * Both are products whose left side is made on the way into local memory. A panel of the first is a run of KT pairs (a, b ..
 * b + KT - 1), of which those with b >= k are zero; a row of the second is a pair.
 *
 * soft_map: launch (row tiles WG, column tiles, splits); ct (k, n): c transposed; packed (k (k + 1) / 2, r); runs (count, 2) int:
 *           a and first b; split s sums runs s split_runs .. (s + 1) split_runs - 1; sums (splits, n, r)
 * moments:  launch (pair tiles WG, column tiles, splits); psi (n, k); w (n); u (n, r); pairs (k (k + 1) / 2, 2) int: a, b;
 *           split s sums rows s split_rows .. (s + 1) split_rows - 1; sums (splits, k (k + 1) / 2, r)
 * numpy twins: clalign.engine.reference.Reference.soft_map, packed_moments_gradient, packed_moments
 */
#include "gpu_tile.cl"

#define FETCH_LEFT(values, first)                                           \
    {                                                                       \
        __global const int *run = runs + 2 * ((first) / KT);                \
        const int a = run[0], i = item % TM;                                \
        for (int q = 0; q < LEFTS; ++q) {                                   \
            const int b = run[1] + STEP(TM, 0, q);                          \
            values[q] = i < rows && b < k ? ct[a * n + i] * ct[b * n + i] : ZERO; \
        }                                                                   \
    }
#define FETCH_RIGHT(values, first)                                          \
    {                                                                       \
        __global const int *run = runs + 2 * ((first) / KT);                \
        const int before = run[0] * k - run[0] * (run[0] + 1) / 2, j = item % TN; \
        for (int q = 0; q < RIGHTS; ++q) {                                  \
            const int b = run[1] + STEP(TN, 0, q);                          \
            values[q] = j < columns && b < k ? packed[(before + b) * r + j] : ZERO; \
        }                                                                   \
    }

KERNEL void soft_map(const int n, const int k, const int r, const int count, const int split_runs,
                     __global const real *restrict ct, __global const real *restrict packed, __global const int *restrict runs,
                     __global real *restrict sums)
{
    TILE_LOCAL
    const int row = get_group_id(0) * TM, column = get_group_id(1) * TN, split = get_group_id(2);
    const int rows = n - row, columns = r - column, first_run = split * split_runs;
    ct += row;
    packed += column;
    runs += 2 * first_run;
    real tile[RM * RN], total[RM * RN];
    clear(tile);
    clear(total);
    TILE_SUM_OF_PARTS(total, tile, min(split_runs, count - first_run) * KT, 0, 0)
    store_tile(total, rows, columns, r, 0, sums + ((size_t)split * n + row) * r + column);
}

#undef FETCH_LEFT
#undef FETCH_RIGHT
#define FETCH_LEFT(values, first)                                                       \
    for (int q = 0; q < LEFTS; ++q) {                                                   \
        const int t = (first) + STEP(TM, 0, q);                                         \
        values[q] = t < depth ? psi[t * k + a] * psi[t * k + b] : ZERO;                 \
    }
#define FETCH_RIGHT(values, first)                                                      \
    for (int q = 0; q < RIGHTS; ++q) {                                                  \
        const int j = item % TN, t = (first) + STEP(TN, 0, q);                          \
        values[q] = j < columns && t < depth ? w[t] * u[t * r + j] : ZERO;\
    }

KERNEL void moments(const int n, const int k, const int r, const int split_rows, __global const real *restrict psi,
                    __global const real *restrict w, __global const real *restrict u, __global const int *restrict pairs,
                    __global real *restrict sums)
{
    TILE_LOCAL
    const int row = get_group_id(0) * TM, column = get_group_id(1) * TN, split = get_group_id(2);
    const int count = k * (k + 1) / 2, rows = count - row, columns = r - column;
    pairs += 2 * row;
    const int own = min(item % TM, rows - 1), a = pairs[2 * own], b = pairs[2 * own + 1];
    const int first_row = split * split_rows, depth = min(split_rows, n - first_row);
    psi += (size_t)first_row * k;
    w += first_row;
    u += (size_t)first_row * r + column;
    real tile[RM * RN], total[RM * RN];
    clear(tile);
    clear(total);
    TILE_SUM_OF_PARTS(total, tile, depth, 0, 0)
    #pragma unroll
    for (int i = 0; i < RM; ++i) {
        const int pair = min(TILE_ROW(i), rows - 1);
        const real factor = pairs[2 * pair] == pairs[2 * pair + 1] ? ONE : ONE + ONE;
        #pragma unroll
        for (int j = 0; j < RN; ++j) total[i * RN + j] *= factor;
    }
    store_tile(total, rows, columns, r, 0, sums + ((size_t)split * count + row) * r + column);
}
