/* The register tile behind every product: RT rows of W columns,
 *
 *     tile[i, :] += sum over t < count of x[i rs + t cs] * panel[t, :],      i < RT
 *
 * with panel rows of W contiguous reals and x read one scalar at a time (a broadcast). 6 x 2 vectors fill the 16 registers
 * of AVX2 without spilling; 5 fits a matrix of 50 or 100 columns without waste. The accumulators are named variables
 * p0, q0, p1, ... because a private array would not stay in registers in every compiler.
 * No kernels of its own; numpy twin: numpy.matmul.
 */
#ifndef RT
#define RT 6 /* rows of a tile: 4 to 10 */
#endif

#if RT == 10
#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5) F(6) F(7) F(8) F(9)
#elif RT == 9
#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5) F(6) F(7) F(8)
#elif RT == 8
#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5) F(6) F(7)
#elif RT == 7
#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5) F(6)
#elif RT == 6
#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5)
#elif RT == 5
#define EACH(F) F(0) F(1) F(2) F(3) F(4)
#elif RT == 4
#define EACH(F) F(0) F(1) F(2) F(3)
#else
#error "RT must be 4 to 10"
#endif

#define DECLARE(i) realv p##i = 0, q##i = 0;
#define OFFSET(i) const size_t o##i = (size_t)min(i, valid_rows - 1) * row_stride;
#define STEP(i)                    \
    {                              \
        const real x = scalars[o##i]; \
        p##i += x * b0;            \
        q##i += x * b1;            \
    }

#define HALF_STEP(i) p##i += scalars[o##i] * b0;

/* Declare the accumulators, and the offsets of the rows; rows from valid_rows on repeat the last valid one. */
#define TILE_BEGIN(stride_of_rows, rows)       \
    const size_t row_stride = (stride_of_rows); \
    const int valid_rows = (rows);              \
    EACH(OFFSET)                                \
    EACH(DECLARE)

/* Add `count` steps; the panel in address space `space` advances by `panel_stride` reals, the scalars by `step`. */
#define TILE_STEPS(space, panel, panel_stride, x_start, step, count) \
    {                                                                 \
        space const real *columns = (panel);                          \
        __global const real *scalars = (x_start);                     \
        for (int t = 0; t < (count); ++t) {                           \
            const realv b0 = LOAD(space, columns);                    \
            const realv b1 = LOAD(space, columns + V);                \
            columns += (panel_stride);                                \
            EACH(STEP)                                                \
            scalars += (step);                                        \
        }                                                             \
    }

/* The same for a panel of which only the first V columns matter. */
#define TILE_HALF_STEPS(space, panel, panel_stride, x_start, step, count) \
    {                                                                      \
        space const real *columns = (panel);                               \
        __global const real *scalars = (x_start);                          \
        for (int t = 0; t < (count); ++t) {                                \
            const realv b0 = LOAD(space, columns);                         \
            columns += (panel_stride);                                     \
            EACH(HALF_STEP)                                                \
            scalars += (step);                                             \
        }                                                                  \
    }

/* Put row i of the accumulators into the tile `sums` (RT, W), or add it unless `fresh` is set. Every block is summed on its
 * own and then added: shorter chains of additions, smaller rounding error. */
#define COLLECT(i)                                                                        \
    STORE(__global, sums + i * W, fresh ? p##i : LOAD(__global, sums + i * W) + p##i);    \
    STORE(__global, sums + i * W + V, fresh ? q##i : LOAD(__global, sums + i * W + V) + q##i);
