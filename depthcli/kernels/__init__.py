"""Kernels: compiled loops on plain arrays, and their compilation. Imports nothing else of depthcli.

To write a kernel:

1. Decorate a module-level function with :func:`~depthcli.kernels.jit.jit`, in the file of the method that calls it. A
   kernel for all threads takes a band of rows, ``kernel(begin, end, ...)``, and is called by
   :func:`~depthcli.kernels.jit.run_bands`. Its output for a row must not depend on the band. A function that only
   kernels call is a :func:`~depthcli.kernels.jit.helper`.
2. A kernel reads and writes plain arrays and numbers. It cannot call ``np.dot`` and ``np.linalg``. Users wait for the
   compiler: give an argument the same type everywhere, and create arrays by ``empty`` and ``zeros`` of ``jit``. Assign
   arrays to slices in a loop: for ``a[:] = b`` numba compiles the text of an error message, which takes seconds.
3. Globals are compiled in as constants. Define them in a file that has kernels itself, so that a change compiles the
   kernels again.
4. NaN and inf keep their meaning in spite of fast math: NaN is "no value" in every map.
5. Take slices of rows before the innermost loop, so that the compiler vectorizes it.
6. Test the kernel against a plain Python loop that computes the same (``tests/naive``).

| module | contents |
|---|---|
| ``jit`` | the decorators, with the compiler options; new arrays; bands of rows on threads; the time of compilation |
| ``cache`` | compiled kernels on disk |
| ``indices`` | names for the positions in arrays |
| ``winners`` | disparities of the smallest costs of both views |
| ``color_steps`` | color differences between neighbors |
| ``exponential`` | fast exponentials; terms of confidence measures |
| ``lanes`` | 16 float32 as one value, for loops that the compiler does not vectorize well |
"""
