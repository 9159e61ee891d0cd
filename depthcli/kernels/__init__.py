"""Compiled loops on plain arrays, and how they are compiled. Imports nothing of ours.

Compilation: ``jit`` has the options, ``cache`` keeps what was compiled, ``fingerprint`` says what a kept kernel was
made from, ``shipped`` reads the kernels that a wheel carries. Kernels that several packages use: ``winners`` (smallest
costs of both views), ``curve`` (cost curves), ``exponential``, ``lanes`` (16 float32 as one value).
"""
