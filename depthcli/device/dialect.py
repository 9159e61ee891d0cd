"""The C dialect of device kernels: OpenCL C, with macros for the differences from CUDA.

A kernel is ``KERNEL void name(GLOBAL const uchar *RESTRICT in, ...)``. In its body:

| macro | meaning |
|---|---|
| ``GLOBAL_ID(n)``, ``LOCAL_ID(n)``, ``GROUP_ID(n)``, ``LOCAL_SIZE(n)`` | ints for dimension n = 0, 1 or 2 |
| ``OWN_PIXEL`` | declares the thread's x and y; ends threads outside ``width`` x ``height`` |
| ``OWN_CELL`` | declares the thread's d, x and y; also ends threads outside ``n_disparities`` |
| ``OWN_INDEX(i, count)`` | declares the thread's i; ends threads from ``count`` on |
| ``LOCAL`` | memory shared by the threads of a group |
| ``BARRIER()`` | waits for all threads of the group |

Sums and products are never fused, so that results are equal on devices and the CPU.
"""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass, replace

OPENCL = """
#pragma OPENCL FP_CONTRACT OFF
#define KERNEL __kernel
#define DEVICE static
#define GLOBAL __global
#define LOCAL __local
#define RESTRICT restrict
#define BARRIER() barrier(CLK_LOCAL_MEM_FENCE)
#define GLOBAL_ID(n) ((int)get_global_id(n))
#define LOCAL_ID(n) ((int)get_local_id(n))
#define GROUP_ID(n) ((int)get_group_id(n))
#define LOCAL_SIZE(n) ((int)get_local_size(n))
#define POPCOUNT(bits) ((int)popcount(bits))
#define ATOMIC_MIN(place, value) atomic_min(place, value)
#define ATOMIC_ADD(place, value) atomic_add(place, value)
#define AS_FLOAT(bits) as_float(bits)
#define NO_VALUE NAN
#ifdef cl_khr_fp64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
#else
typedef float real;
#endif
typedef long index_t;
"""

CUDA = """
typedef unsigned char uchar;
typedef unsigned short ushort;
typedef unsigned int uint;
typedef unsigned long long ulong;
typedef double real;
typedef long long index_t;
#define KERNEL extern "C" __global__
#define DEVICE static __device__ __forceinline__
#define GLOBAL
#define LOCAL __shared__
#define RESTRICT __restrict__
#define BARRIER() __syncthreads()
#define _ID_0(what) what.x
#define _ID_1(what) what.y
#define _ID_2(what) what.z
#define LOCAL_ID(n) ((int)(_ID_##n(threadIdx)))
#define GROUP_ID(n) ((int)(_ID_##n(blockIdx)))
#define LOCAL_SIZE(n) ((int)(_ID_##n(blockDim)))
#define GLOBAL_ID(n) (GROUP_ID(n) * LOCAL_SIZE(n) + LOCAL_ID(n))
#define POPCOUNT(bits) __popcll(bits)
#define ATOMIC_MIN(place, value) atomicMin((int *)(place), value)
#define ATOMIC_ADD(place, value) atomicAdd((int *)(place), value)
#define AS_FLOAT(bits) __int_as_float(bits)
#define NO_VALUE __int_as_float(0x7fc00000)
"""

COMMON = """
#define OWN_INDEX(i, count) int i = GLOBAL_ID(0); if (i >= (count)) return
#define OWN_PIXEL int x = GLOBAL_ID(0), y = GLOBAL_ID(1); if (x >= width || y >= height) return
#define OWN_CELL int d = GLOBAL_ID(0), x = GLOBAL_ID(1), y = GLOBAL_ID(2); \\
    if (d >= n_disparities || x >= width || y >= height) return
DEVICE int distance_of(int a, int b) { return a < b ? b - a : a - b; }
DEVICE int within(int low, int value, int high) { return value < low ? low : value > high ? high : value; }
DEVICE int smaller(int a, int b) { return a < b ? a : b; }
DEVICE int larger(int a, int b) { return a > b ? a : b; }
DEVICE float smaller_f(float a, float b) { return a < b ? a : b; }
DEVICE float larger_f(float a, float b) { return a > b ? a : b; }
DEVICE int no_value(float v) { return v != v; }
"""


@dataclass(frozen=True)
class Kernels:
    """The kernels in a ``file`` of C text in a ``package``, with ``macros`` that are defined before the text."""

    package: str
    file: str
    macros: tuple[tuple[str, str | int], ...] = ()

    def with_macros(self, **macros: str | int) -> Kernels:
        """Return the same file with other macros."""
        return replace(self, macros=tuple(sorted(macros.items())))

    @property
    def text(self) -> str:
        """Return the macros and the file as one text."""
        lines = [f"#define {name} {value}\n" for name, value in self.macros]
        return "".join([*lines, COMMON, importlib.resources.files(self.package).joinpath(self.file).read_text("utf-8")])
