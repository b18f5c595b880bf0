/* The tile behind every product of the class of GPUs: a work-group owns TM x TN sums, a work-item RM x RN of them,
 *
 *     tile[i, j] += sum over t < depth of left(t, i) right(t, j)
 *
 * The WG = SIDE x SIDE items fetch a panel of KT steps of both sides into registers while they multiply the one before it from
 * local memory, where panels lie as [KT][TM + PAD] and [KT][TN + PAD]. An item owns rows and columns in blocks of four, SIDE
 * blocks apart, so that neighbours read neighbouring vectors.
 *
 * A file that includes this one defines FETCH_LEFT(values, first) and FETCH_RIGHT(values, first): the item's LEFTS and RIGHTS
 * elements of the steps from `first` on, zero beyond the matrix. Element q is number NUMBER(T, along, q) of the T rows, or
 * columns, and number STEP(T, along, q) of the steps: with `along` neighbouring items take neighbouring steps, else neighbouring
 * rows, whichever lie next to each other in memory.
 *
 * TM, TN, KT: multiples of 64 both, and a divisor of WG; WG = 256. left, right: two panels each in local memory, which
 * TILE_LOCAL declares.
 * No kernels of its own; numpy twin: numpy.matmul.
 */
#define SIDE 16
#if WG != SIDE * SIDE
#error "WG must be 256"
#endif
#ifndef TM
#error "TM must be given: the rows of the tile of a work-group"
#endif
#ifndef TN
#error "TN must be given: the columns of the tile of a work-group"
#endif
#ifndef KT
#error "KT must be given: the depth of a panel in local memory"
#endif
#ifndef UNROLL
#define UNROLL 4 /* steps that are multiplied in a row */
#endif
#ifndef CHAIN
#define CHAIN 128 /* longest sum in one go, a multiple of KT: longer ones are summed in parts, which are then added */
#endif
#define PAD 4 /* keeps what 32 items write at once in different banks */
#define RM (TM / SIDE)
#define RN (TN / SIDE)
#define LEFTS (TM * KT / WG)
#define RIGHTS (TN * KT / WG)
#define LEFT_PANEL (KT * (TM + PAD))
#define RIGHT_PANEL (KT * (TN + PAD))

#if PRECISION == 64
typedef double4 real4;
#else
typedef float4 real4;
#endif

#define TILE_LOCAL                                   \
    __local real4 left_panels[2 * LEFT_PANEL / 4];   \
    __local real4 right_panels[2 * RIGHT_PANEL / 4]; \
    __local real *const left = (__local real *)left_panels, *const right = (__local real *)right_panels; \
    const int item = get_local_id(0);

#define NUMBER(T, along, q) ((along) ? item / KT + (q) * (WG / KT) : item % (T))
#define STEP(T, along, q) ((along) ? item % KT : item / (T) + (q) * (WG / (T)))

/* Row and column, within the tile of the group, of element (i, j) of the item's. */
#define TILE_ROW(i) (item / SIDE * 4 + (i) / 4 * 4 * SIDE + (i) % 4)
#define TILE_COLUMN(j) (item % SIDE * 4 + (j) / 4 * 4 * SIDE + (j) % 4)

#define PUT(T, along, count, values, panel) \
    for (int q = 0; q < (count); ++q) \
        (panel)[STEP(T, along, q) * ((T) + PAD) + NUMBER(T, along, q)] = values[q];

INLINE void load_fours(real *to, const int blocks, __local const real *from)
{
    #pragma unroll
    for (int q = 0; q < blocks; ++q) {
        const real4 four = *(__local const real4 *)(from + q * 4 * SIDE);
        to[4 * q] = four.x;
        to[4 * q + 1] = four.y;
        to[4 * q + 2] = four.z;
        to[4 * q + 3] = four.w;
    }
}

/* tile += left panel^T right panel, over `count` steps. */
INLINE void multiply(real *tile, const int count, __local const real *left, __local const real *right)
{
    const int item = get_local_id(0);
    left += TILE_ROW(0);
    right += TILE_COLUMN(0);
    #pragma unroll UNROLL
    for (int t = 0; t < count; ++t) {
        real x[RM], y[RN];
        load_fours(x, RM / 4, left + t * (TM + PAD));
        load_fours(y, RN / 4, right + t * (TN + PAD));
        #pragma unroll
        for (int i = 0; i < RM; ++i)
            #pragma unroll
            for (int j = 0; j < RN; ++j) tile[i * RN + j] += x[i] * y[j];
    }
}

INLINE void clear(real *tile)
{
    #pragma unroll
    for (int e = 0; e < RM * RN; ++e) tile[e] = ZERO;
}

/* total += tile, which is cleared for the next part of the sum. */
INLINE void add_part(real *total, real *tile)
{
    #pragma unroll
    for (int e = 0; e < RM * RN; ++e) {
        total[e] += tile[e];
        tile[e] = ZERO;
    }
}

/* Store the item's part of the rows and columns that exist, or add it. */
INLINE void store_tile(const real *tile, const int rows, const int columns, const int stride, const int accumulate,
                       __global real *to)
{
    const int item = get_local_id(0);
    #pragma unroll
    for (int i = 0; i < RM; ++i)
        if (TILE_ROW(i) < rows) {
            __global real *line = to + (size_t)TILE_ROW(i) * stride;
            #pragma unroll
            for (int j = 0; j < RN; ++j)
                if (TILE_COLUMN(j) < columns)
                    line[TILE_COLUMN(j)] = accumulate ? line[TILE_COLUMN(j)] + tile[i * RN + j] : tile[i * RN + j];
        }
}

/* tile += the sum over `depth` steps. All items come here, with the same depth; local memory is free again at the end. */
#define TILE_SUM(tile, depth, left_along, right_along) TILE_LOOP(tile, depth, left_along, right_along, )
/* The same for a long sum: total += parts of CHAIN steps. Short chains of additions, small rounding error. */
#define TILE_SUM_OF_PARTS(total, tile, depth, left_along, right_along)                                   \
    TILE_LOOP(tile, depth, left_along, right_along, if (next % CHAIN == 0) add_part(total, tile);)       \
    add_part(total, tile);
#define TILE_LOOP(tile, depth, left_along, right_along, AFTER_PANEL)                                     \
    {                                                                                                    \
        real lefts[LEFTS], rights[RIGHTS];                                                               \
        FETCH_LEFT(lefts, 0)                                                                             \
        FETCH_RIGHT(rights, 0)                                                                           \
        PUT(TM, left_along, LEFTS, lefts, left)                                                          \
        PUT(TN, right_along, RIGHTS, rights, right)                                                      \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                    \
        int half_used = 0;                                                                               \
        for (int done = 0; done < (depth); done += KT) {                                                 \
            const int next = done + KT;                                                                  \
            if (next < (depth)) {                                                                        \
                FETCH_LEFT(lefts, next)                                                                  \
                FETCH_RIGHT(rights, next)                                                                \
            }                                                                                            \
            multiply(tile, min(KT, (depth) - done), left + half_used * LEFT_PANEL, right + half_used * RIGHT_PANEL); \
            half_used = 1 - half_used;                                                                   \
            if (next < (depth)) {                                                                        \
                PUT(TM, left_along, LEFTS, lefts, left + half_used * LEFT_PANEL)                         \
                PUT(TN, right_along, RIGHTS, rights, right + half_used * RIGHT_PANEL)                    \
            }                                                                                            \
            AFTER_PANEL                                                                                  \
            barrier(CLK_LOCAL_MEM_FENCE);                                                                \
        }                                                                                                \
    }
