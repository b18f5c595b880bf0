/* A panel of features made on the fly, times a matrix packed in tiles:
 *
 *     total[tile, i, :] (+)= sum over t < count of right[tile, t, i] * made[t, :]
 *
 * made (count, W) in private memory; right (tiles, length, RT) in global memory, packed by pack_tiles; total
 * (tiles, RT, W) in global scratch, where the sums wait between two blocks of features; numpy twin: numpy.matmul.
 */
#include "tile.cl"

#ifndef FB
#define FB 256 /* features made at once: FB * W reals of private memory */
#endif

INLINE void panel_times_tiles(const realv *made, const int count, __global const real *right, const size_t tile_stride,
                              const int tiles, __global real *total, const int fresh)
{
    for (int tile = 0; tile < tiles; ++tile) {
        __global real *sums = total + (size_t)tile * RT * W;
        TILE_BEGIN(1, RT)
        TILE_STEPS(__private, (const real *)made, W, right + tile * tile_stride, RT, count)
        EACH(COLLECT)
    }
}
