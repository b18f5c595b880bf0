/* What two distances differ by in the distortion of a candidate map:
 *
 *     e(x, y) = (x - y)^2, or |x - y| / (x + y + FLOOR) with -D FLOOR=...
 *
 * No kernels of its own; numpy twin: clalign.engine.reference.Reference.distortion_batch
 */
INLINE real error_of(const real x, const real y)
{
    const real difference = x - y;
#ifdef FLOOR
    return (difference < ZERO ? -difference : difference) / (x + y + (real)FLOOR);
#else
    return difference * difference;
#endif
}
