"""Kernels: compiled loops on plain arrays, and how they are compiled. Imports nothing else of depthcli.

To write one:

1. Decorate a function with :func:`~depthcli.kernels.jit.jit`. It lies at module level, in the file of the method that
   calls it. If it is to run on all threads, it takes a band of rows, ``kernel(begin, end, ...)``, and is called by
   :func:`~depthcli.kernels.jit.run_bands`; what it writes for a row must not depend on the band.
2. It takes and fills plain arrays and numbers. ``np.dot`` and ``np.linalg`` cannot be called. A loop assigns arrays to
   slices: for ``a[:] = b`` numba compiles the text of an error message, which takes seconds.
3. Globals that it reads are constants, compiled in; they are defined in a file that has kernels itself, so that a
   changed one compiles anew.
4. NaN and inf keep their meaning in spite of fast math: NaN is "no value" in every map.
5. Take slices of rows before the innermost loop, so that the compiler vectorizes it.
6. Test it against a plain loop of Python that computes the same (``tests/naive``).

| module | holds |
|---|---|
| ``jit`` | the decorator, with the compiler options; bands of rows on threads; the time of compilation |
| ``cache`` | compiled kernels on disk |
| ``winners`` | disparities of the smallest costs of both views |
| ``exponential`` | fast exponentials; terms of confidence measures |
| ``lanes`` | 16 float32 as one value, for loops that the compiler does not vectorize well |
"""
