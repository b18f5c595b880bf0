/* Types and macros that every kernel file starts from.
 *
 * real     float or double, by -D PRECISION=32 or 64 (required)
 * realv    V reals: one vector register;  intv: V signed integers as wide as a real, what comparing realv gives
 * W        2 V, the lanes of a panel: a matrix stored as [panel][row][W] so that a row of a panel is two vectors
 * LOAD, STORE   vectors at addresses aligned to one real. vloadn is a call that PoCL does not inline
 * KERNEL   a kernel whose work-items are independent, in groups of -D WG (1 on a CPU)
 * fma() is never called: with -cl-mad-enable the compiler contracts a * b + c itself.
 */
#ifndef PRECISION
#error "PRECISION must be given: 32 or 64"
#endif
#ifndef WG
#error "WG must be given: the work-items of a group"
#endif

#if PRECISION == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#ifndef V
#define V 4
#endif
typedef double real;
typedef long whole;
typedef double4 realv;
typedef long4 intv;
#define REAL_BYTES 8
#elif PRECISION == 32
#ifndef V
#define V 8
#endif
typedef float real;
typedef int whole;
typedef float8 realv;
typedef int8 intv;
#define REAL_BYTES 4
#else
#error "PRECISION must be 32 or 64"
#endif

#define W (2 * V)
typedef realv loose __attribute__((aligned(REAL_BYTES)));

#define LOAD(space, address) (*(space const loose *)(address))
#define STORE(space, address, value) (*(space loose *)(address) = (value))
#define KERNEL __kernel __attribute__((reqd_work_group_size(WG, 1, 1)))
#define KERNEL_OF(items) __kernel __attribute__((reqd_work_group_size(items, 1, 1)))
#define ZERO ((real)0)
#define ONE ((real)1)
