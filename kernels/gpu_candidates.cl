/* Scores of B candidate maps at once, as candidates.cl says, for the class of GPUs.
 *
 *     distortion[b]   = sum over i, l of w_i w_l e(dx[T_i, T_l], dy[i, l]),      T = index[:, b]
 *     distance[a, b]  = sum over i of w_i dx[index[i, a], index[i, b]]
 *
 * distortion:   launch (WG, maps), a work-group a map: ROW_ITEMS neighbouring items share a row i; index (m, maps) int; dx (p, p);
 *               dy (m, m); w (m); out (maps)
 * map_distance: launch (maps, maps), an item an entry; index (m, maps) int; distance (maps, maps)
 * numpy twins: clalign.engine.reference.Reference.distortion_batch, map_distance
 */
#include "gpu_sums.cl"
#include "distortion_error.cl"

#define ROW_ITEMS 32

KERNEL void distortion(const int m, const int p, const int maps, __global const real *restrict dx,
                       __global const real *restrict dy, __global const real *restrict w, __global const int *restrict index,
                       __global real *restrict out)
{
    __local real space[WG];
    const int item = get_local_id(0), map = get_group_id(1);
    real total = ZERO;
    index += map;
    for (int i = item / ROW_ITEMS; i < m; i += WG / ROW_ITEMS) {
        __global const real *here = dx + (size_t)index[(size_t)i * maps] * p, *there = dy + (size_t)i * m;
        real sum = ZERO;
        for (int l = item % ROW_ITEMS; l < m; l += ROW_ITEMS)
            sum += w[l] * error_of(here[index[(size_t)l * maps]], there[l]);
        total += w[i] * sum;
    }
    total = group_sum(total, space, WG);
    if (item == 0) out[map] = total;
}

KERNEL void map_distance(const int m, const int maps, const int p, __global const real *restrict dx,
                         __global const real *restrict w, __global const int *restrict index, __global real *restrict distance)
{
    const int a = get_global_id(1), b = get_global_id(0);
    if (b >= maps) return;
    real sum = ZERO;
    for (int i = 0; i < m; ++i) {
        __global const int *row = index + (size_t)i * maps;
        sum += w[i] * dx[(size_t)row[a] * p + row[b]];
    }
    distance[(size_t)a * maps + b] = sum;
}
