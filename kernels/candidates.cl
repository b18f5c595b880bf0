/* Scores of B candidate maps at once, from distances between m samples of Y and p samples of X.
 *
 *     distortion[b]   = sum over i, l of w_i w_l e(dx[T_i, T_l], dy[i, l]),      T = maps[b]
 *     e(x, y)         = (x - y)^2, or |x - y| / (x + y + FLOOR) with -D FLOOR=...
 *     distance[a, b]  = sum over i of w_i dx[index[i, a], index[i, b]]
 *
 * transpose_maps:   launch (maps); index (m, maps) to rows (maps, m)
 * distortion_parts: launch (parts, maps); rows (maps, m) int; dx (p, p); dy (m, m); w (m); partial (maps, parts): part q
 *                   sums rows i = q DB .. (q + 1) DB - 1; finish_rows of reduce.cl adds the parts
 * map_distance:     launch (ceil(maps / W), maps); index (m, maps); distance (maps, maps)
 * numpy twins: clalign.engine.reference.Reference.distortion_batch, map_distance
 */
#include "distortion_error.cl"

#ifndef DB
#define DB 64 /* rows of one part */
#endif

KERNEL void transpose_maps(const int m, const int maps, __global const int *restrict index, __global int *restrict rows)
{
    const int b = get_global_id(0);
    if (b >= maps) return;
    for (int i = 0; i < m; ++i) rows[(size_t)b * m + i] = index[(size_t)i * maps + b];
}

KERNEL void distortion_parts(const int m, const int p, const int parts, __global const real *restrict dx,
                             __global const real *restrict dy, __global const real *restrict w,
                             __global const int *restrict rows, __global real *restrict partial)
{
    const int part = get_global_id(0), begin = part * DB, end = min(begin + DB, m);
    if (part >= parts) return;
    __global const int *map = rows + get_global_id(1) * (size_t)m;
    real total = ZERO;
    for (int i = begin; i < end; ++i) {
        __global const real *here = dx + (size_t)map[i] * p, *there = dy + (size_t)i * m;
        real sum0 = ZERO, sum1 = ZERO, sum2 = ZERO, sum3 = ZERO;
        int l = 0;
        for (; l + 4 <= m; l += 4) {
            sum0 += w[l] * error_of(here[map[l]], there[l]);
            sum1 += w[l + 1] * error_of(here[map[l + 1]], there[l + 1]);
            sum2 += w[l + 2] * error_of(here[map[l + 2]], there[l + 2]);
            sum3 += w[l + 3] * error_of(here[map[l + 3]], there[l + 3]);
        }
        for (; l < m; ++l) sum0 += w[l] * error_of(here[map[l]], there[l]);
        total += w[i] * ((sum0 + sum1) + (sum2 + sum3));
    }
    partial[get_global_id(1) * (size_t)parts + part] = total;
}

KERNEL void map_distance(const int m, const int maps, const int p, __global const real *restrict dx,
                         __global const real *restrict w, __global const int *restrict index, __global real *restrict distance)
{
    const int a = get_global_id(1), first = get_global_id(0) * W, count = min(W, maps - first);
    if (first >= maps) return;
    real sums[W];
    for (int b = 0; b < W; ++b) sums[b] = ZERO;
    for (int i = 0; i < m; ++i) {
        __global const int *row = index + (size_t)i * maps;
        __global const real *from = dx + (size_t)row[a] * p;
        for (int b = 0; b < count; ++b) sums[b] += w[i] * from[row[first + b]];
    }
    for (int b = 0; b < count; ++b) distance[(size_t)a * maps + first + b] = sums[b];
}
