/* What two distances differ by in the distortion of a candidate map:
 *
 *     e(x, y) = (x - y)^2, or |x - y| / (x + y + FLOOR) with -D RELATIVE=1
 *
 * No kernels of its own; numpy twin: clalign.engine.reference.Reference.distortion_batch
 */
#ifndef RELATIVE
#define RELATIVE 0
#endif
#ifndef FLOOR
#error "FLOOR must be given: the constant in the denominator of the relative distortion"
#endif

INLINE real error_of(const real x, const real y)
{
    const real difference = x - y;
#if RELATIVE
    return (difference < ZERO ? -difference : difference) / (x + y + (real)FLOOR);
#else
    return difference * difference;
#endif
}
