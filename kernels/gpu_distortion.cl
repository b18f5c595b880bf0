/* The small matrices of the distortion (Eq. 22) in one launch of one work-group, for the class of GPUs:
 *
 *     T_X, T_Y the cores, B = U^T Omega Z (r_x, r_y), G = Z'^T Omega Z' (r_y, r_y), G_Z = B^T B + G
 *     value  = |T_X - B T_Y B^T|^2 + 2 tr(B T_Y G T_Y B^T) + tr(T_Y G T_Y G)
 *     last   = (T_X B - B T_Y G_Z) T_Y (r_x, r_y),      across = T_Y G_Z T_Y (r_y, r_y)
 *
 * Eleven products, each of one tile, one after the other: a launch for each would take longer than they do.
 *
 * distortion_core: launch (WG); r_x, r_y <= 64; core_x (r_x, r_x), core_y (r_y, r_y), inside = B, gram = G, which becomes G_Z;
 *                  work (7, 64, 64) scratch; value (1); last, across
 * numpy twin: clalign.engine.reference.Reference.distortion
 */
#include "gpu_tile.cl"
#include "gpu_sums.cl"

#if TM != 64 || TN != 64
#error "TM and TN must be 64: a matrix is one tile"
#endif

#define FETCH_LEFT(values, first)                                                          \
    for (int q = 0; q < LEFTS; ++q) {                                                      \
        const int i = NUMBER(TM, a_along, q), t = (first) + STEP(TM, a_along, q);          \
        values[q] = i < m && t < depth ? a[i * a_row + t * a_step] : ZERO;                 \
    }
#define FETCH_RIGHT(values, first)                                                         \
    for (int q = 0; q < RIGHTS; ++q) {                                                     \
        const int j = NUMBER(TN, b_along, q), t = (first) + STEP(TN, b_along, q);          \
        values[q] = j < n && t < depth ? b[t * b_step + j * b_column] : ZERO;              \
    }

/* c (m, n) = base + sign op(a) op(b); base may be c, or NULL. */
INLINE void small_product(const int m, const int n, const int depth, __global const real *a, const int transpose_a,
                          __global const real *b, const int transpose_b, __global const real *base, const real sign,
                          __global real *c, __local real *left, __local real *right)
{
    const int item = get_local_id(0);
    const int a_row = transpose_a ? 1 : depth, a_step = transpose_a ? m : 1, a_along = !transpose_a;
    const int b_step = transpose_b ? 1 : n, b_column = transpose_b ? depth : 1, b_along = transpose_b;
    real tile[RM * RN];
    clear(tile);
    TILE_SUM(tile, depth, a_along, b_along)
    #pragma unroll
    for (int i = 0; i < RM; ++i)
        #pragma unroll
        for (int j = 0; j < RN; ++j) {
            const int e = TILE_ROW(i) * n + TILE_COLUMN(j);
            if (TILE_ROW(i) < m && TILE_COLUMN(j) < n) c[e] = sign * tile[i * RN + j] + (base ? base[e] : ZERO);
        }
    barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE);
}

INLINE real items_dot(const int count, __global const real *x, __global const real *y)
{
    real sum = ZERO;
    for (int e = get_local_id(0); e < count; e += WG) sum += x[e] * y[e];
    return sum;
}

KERNEL void distortion_core(const int r_x, const int r_y, __global const real *core_x, __global const real *core_y,
                            __global const real *inside, __global real *gram, __global real *work, __global real *value,
                            __global real *last, __global real *across)
{
    TILE_LOCAL
    __local real space[WG];
    __global real *const mapped = work, *const residual = work + TM * TN, *const core_gram = work + 2 * TM * TN;
    __global real *const gram_core = work + 3 * TM * TN, *const mixed = work + 4 * TM * TN;
    __global real *const core_full = work + 5 * TM * TN, *const along = work + 6 * TM * TN;
    for (int step = 0; step < 11; ++step) {
        int m = r_y, n = r_y, depth = r_y, transpose_a = 0, transpose_b = 0;
        __global const real *a = core_y, *b = core_y, *base = 0;
        __global real *c = mapped;
        real sign = ONE;
        switch (step) {
        case 0: a = inside; m = r_x; break;
        case 1: a = mapped; b = inside; transpose_b = 1; base = core_x; sign = -ONE; c = residual; m = n = r_x; break;
        case 2: b = gram; c = core_gram; break;
        case 3: a = gram; c = gram_core; break;
        case 4: a = mapped; b = gram_core; c = mixed; m = r_x; break;
        case 5: a = b = inside; transpose_a = 1; base = c = gram; depth = r_x; break;
        case 6: b = gram; c = core_full; break;
        case 7: a = core_x; b = inside; c = along; m = depth = r_x; break;
        case 8: a = inside; b = core_full; base = c = along; sign = -ONE; m = r_x; break;
        case 9: a = along; c = last; m = r_x; break;
        default: a = core_full; c = across; break;
        }
        small_product(m, n, depth, a, transpose_a, b, transpose_b, base, sign, c, left, right);
    }
    const real total = items_dot(r_x * r_x, residual, residual) + 2 * items_dot(r_x * r_y, mixed, inside) +
                       items_dot(r_y * r_y, core_gram, gram_core);
    const real sum = group_sum(total, space, WG);
    if (item == 0) value[0] = sum;
}
