/* Types and macros that every kernel file starts from.
 *
 * real     float or double, by -D PRECISION=32 or 64 (required)
 * realv    V reals, by -D V=4, 8 or 16: one vector register;  intv: V signed integers as wide as a real, what comparing
 *          realv gives
 * integer  a signed integer as wide as a real
 * W        2 V, the columns (lanes) of a panel: a matrix stored as [panel][row][W] so that a row of a panel is two vectors
 * LOAD, STORE   vectors at addresses aligned to one real. vloadn is a call that PoCL does not inline
 * PREFETCH a cache line, to be read or written (0 or 1)
 * KERNEL   a kernel whose work-items are independent, in work-groups of -D WG (1 on a CPU, which -D ON_CPU=1 says)
 * fma() is never called: with -cl-mad-enable the compiler contracts a * b + c itself.
 */
#ifndef PRECISION
#error "PRECISION must be given: 32 or 64"
#endif
#ifndef WG
#error "WG must be given: the work-items of a work-group"
#endif
#ifndef ON_CPU
#error "ON_CPU must be given: 1 on devices of the class of CPUs, else 0"
#endif

#if PRECISION == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#ifndef V
#define V 4
#endif
typedef double real;
typedef long integer;
#define VECTORS(width) typedef double##width realv; typedef long##width intv;
#define REAL_BYTES 8
#elif PRECISION == 32
#ifndef V
#define V 8
#endif
typedef float real;
typedef int integer;
#define VECTORS(width) typedef float##width realv; typedef int##width intv;
#define REAL_BYTES 4
#else
#error "PRECISION must be 32 or 64"
#endif

#if V == 4
VECTORS(4)
#elif V == 8
VECTORS(8)
#elif V == 16
VECTORS(16)
#else
#error "V must be 4, 8 or 16"
#endif

#define W (2 * V)
typedef realv unaligned __attribute__((aligned(REAL_BYTES)));

#define LOAD(space, address) (*(space const unaligned *)(address))
#define STORE(space, address, value) (*(space unaligned *)(address) = (value))
#define KERNEL __kernel __attribute__((reqd_work_group_size(WG, 1, 1)))
#define KERNEL_OF(items) __kernel __attribute__((reqd_work_group_size(items, 1, 1)))
/* A function that is part of every kernel that calls it: one of its own would be compiled for shorter vectors. */
#define INLINE inline __attribute__((always_inline))
/* Ask for a cache line before it is needed, where work-items are a CPU's and the compiler can. There all address spaces are
 * one, which the way through a number says. */
#if ON_CPU && defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
#define PREFETCH(address, write) __builtin_prefetch((const void *)(size_t)(address), write)
#endif
#endif
#ifndef PREFETCH
#define PREFETCH(address, write)
#endif
#define LINE (64 / REAL_BYTES) /* reals of a cache line */
#define ZERO ((real)0)
#define ONE ((real)1)
