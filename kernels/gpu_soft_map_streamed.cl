/* The soft map from tiles of q_ij = psi_i . c_j for the class of GPUs, without its last step, the division by s_j:
 *
 *     sums[j, r] = sum_i w_i q_ij^2 u[i, r],      weights[j] = s_j = sum_i w_i q_ij^2
 *     sums[j, :] = sum_i w_i q_ij (sum_r dz[j, r] u[i, r] - removed_j) psi_i,   removed_j = sum_r dz[j, r] z[j, r]
 *
 * Two chained tiles: q of TM rows and TN vertices i, which goes to local memory weighted, and is there the left side of the
 * second product. Every tile of vertices is summed on its own and then added: short chains of additions.
 *
 * Both launch (row tiles WG, column tiles or 1, splits); c (n, k); psi (n_y, k); w (n_y); u (n_y, r); split s sums the tiles
 * s split_tiles .. (s + 1) split_tiles - 1 of vertices.
 * soft_map_streamed: column tiles of r; sums (splits, n, r); weights (splits, n)
 * soft_map_streamed_gradient: dz (n, r); removed (n); sums (splits, n, k)
 * numpy twins: clalign.engine.reference.Reference.soft_map_streamed, soft_map_streamed_gradient
 */
#include "gpu_tile.cl"

#if TM != 64 || TN != 64
#error "TM and TN must be 64: a tile of q is one panel of the second product"
#endif

#define FETCH_LEFT(values, first)                                                             \
    for (int q = 0; q < LEFTS; ++q) {                                                         \
        const int i = NUMBER(TM, 1, q), t = (first) + STEP(TM, 1, q);                         \
        values[q] = i < rows && t < length ? left_from[i * length + t] : ZERO;                \
    }
#define FETCH_RIGHT(values, first)                                                            \
    for (int q = 0; q < RIGHTS; ++q) {                                                        \
        const int j = NUMBER(TN, 1, q), t = (first) + STEP(TN, 1, q);                         \
        values[q] = j < vertices && t < length ? right_from[j * length + t] : ZERO;           \
    }

/* The weighted tile of q, in local memory as a panel of TN steps. */
#define WEIGHTED_LOCAL                                          \
    __local real4 weighted_panel[TN * (TM + PAD) / 4];          \
    __local real *const weighted = (__local real *)weighted_panel;
#define WEIGHTED(i, j) weighted[TILE_COLUMN(j) * (TM + PAD) + TILE_ROW(i)]

/* tile = `weighted` times the rows of `from` (vertices, width), of which `columns` count. */
#define SECOND_PRODUCT(from, width, columns)                                                            \
    clear(tile);                                                                                        \
    for (int first = 0; first < TN; first += KT) {                                                      \
        __local real *panel = right + first / KT % 2 * RIGHT_PANEL;                                     \
        for (int q = 0; q < RIGHTS; ++q) {                                                              \
            const int j = item % TN, step = STEP(TN, 0, q), t = first + step;                           \
            panel[step * (TN + PAD) + j] = j < (columns) && t < vertices ? (from)[t * (width) + j] : ZERO; \
        }                                                                                               \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                   \
        multiply(tile, KT, weighted + first * (TM + PAD), panel);                                       \
    }                                                                                                   \
    barrier(CLK_LOCAL_MEM_FENCE);

KERNEL void soft_map_streamed(const int n, const int n_y, const int k, const int r, const int split_tiles,
                              __global const real *restrict c, __global const real *restrict psi,
                              __global const real *restrict w, __global const real *restrict u, __global real *restrict sums,
                              __global real *restrict weights)
{
    TILE_LOCAL
    WEIGHTED_LOCAL
    const int row = get_group_id(0) * TM, column = get_group_id(1) * TN, split = get_group_id(2);
    const int rows = n - row, columns = r - column, length = k;
    __global const real *left_from = c + (size_t)row * k;
    real total[RM * RN], row_sums[RM], tile[RM * RN];
    clear(total);
    for (int i = 0; i < RM; ++i) row_sums[i] = ZERO;
    const int last = min((split + 1) * split_tiles * TN, n_y);
    for (int vertex = split * split_tiles * TN; vertex < last; vertex += TN) {
        const int vertices = n_y - vertex;
        __global const real *right_from = psi + (size_t)vertex * k;
        clear(tile);
        TILE_SUM(tile, k, 1, 1)
        #pragma unroll
        for (int j = 0; j < RN; ++j) {
            const int at = TILE_COLUMN(j);
            const real weight = at < vertices ? w[vertex + at] : ZERO;
            #pragma unroll
            for (int i = 0; i < RM; ++i) {
                const real share = weight * tile[i * RN + j] * tile[i * RN + j];
                row_sums[i] += share;
                WEIGHTED(i, j) = share;
            }
        }
        SECOND_PRODUCT(u + (size_t)vertex * r + column, r, columns)
        #pragma unroll
        for (int e = 0; e < RM * RN; ++e) total[e] += tile[e];
    }
    store_tile(total, rows, columns, r, 0, sums + ((size_t)split * n + row) * r + column);
    #pragma unroll
    for (int i = 0; i < RM; ++i) weighted[TILE_ROW(i) * SIDE + item % SIDE] = row_sums[i];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (column == 0 && item < min(TM, rows)) {
        real sum = ZERO;
        for (int e = 0; e < SIDE; ++e) sum += weighted[item * SIDE + e];
        weights[(size_t)split * n + row + item] = sum;
    }
}

KERNEL void soft_map_streamed_gradient(const int n, const int n_y, const int k, const int r, const int split_tiles,
                                       __global const real *restrict c, __global const real *restrict psi,
                                       __global const real *restrict w, __global const real *restrict u,
                                       __global const real *restrict dz, __global const real *restrict removed,
                                       __global real *restrict sums)
{
    TILE_LOCAL
    WEIGHTED_LOCAL
    const int row = get_group_id(0) * TM, split = get_group_id(2), rows = n - row;
    sums += ((size_t)split * n + row) * k;
    real tile[RM * RN];
    const int begin = split * split_tiles * TN, last = min(begin + split_tiles * TN, n_y);
    for (int vertex = begin; vertex < last; vertex += TN) {
        const int vertices = n_y - vertex;
        int length = r;
        __global const real *left_from = dz + (size_t)row * r, *right_from = u + (size_t)vertex * r;
        clear(tile);
        TILE_SUM(tile, length, 1, 1)
        #pragma unroll
        for (int i = 0; i < RM; ++i) {
            const real level = TILE_ROW(i) < rows ? removed[row + TILE_ROW(i)] : ZERO;
            #pragma unroll
            for (int j = 0; j < RN; ++j) {
                const real weight = TILE_COLUMN(j) < vertices ? w[vertex + TILE_COLUMN(j)] : ZERO;
                WEIGHTED(i, j) = weight * (tile[i * RN + j] - level);
            }
        }
        length = k;
        left_from = c + (size_t)row * k;
        right_from = psi + (size_t)vertex * k;
        clear(tile);
        TILE_SUM(tile, length, 1, 1)
        #pragma unroll
        for (int i = 0; i < RM; ++i)
            #pragma unroll
            for (int j = 0; j < RN; ++j) WEIGHTED(i, j) *= tile[i * RN + j];
        for (int column = 0; column < k; column += TN) {
            SECOND_PRODUCT(right_from + column, k, k - column)
            store_tile(tile, rows, k - column, k, vertex > begin, sums + column);
        }
    }
}
