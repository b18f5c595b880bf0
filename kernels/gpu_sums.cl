/* Sums over the items of a work-group, in one fixed order: a tree in local memory.
 *
 *     group_sum(value, space, items) = sum of the values of `items` neighbouring items, a power of two; all of them get it
 *
 * All items of the work-group call. space: WG reals of local memory, free again at the end.
 * No kernels of its own; numpy twin: numpy.sum.
 */
INLINE real group_sum(const real value, __local real *space, const int items)
{
    const int item = get_local_id(0);
    space[item] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int half_of = items / 2; half_of > 0; half_of /= 2) {
        if (item % items < half_of) space[item] += space[item + half_of];
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const real total = space[item / items * items];
    barrier(CLK_LOCAL_MEM_FENCE);
    return total;
}
