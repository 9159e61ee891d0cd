"""What the machine code of a kernel is made from, as one digest."""

from __future__ import annotations

import enum
import hashlib
import sys
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.dispatcher import Dispatcher


def fingerprint(kernel: Any) -> str:
    """Return the digest of all that the machine code of ``kernel`` is made from, as hexadecimal digits.

    That is the byte code, constants and compiler options of the kernel and of every kernel that it calls, in any file;
    the values of all globals that they read; the source files of intrinsics (operations defined by the LLVM code that
    they emit) and overloads; numba's settings and the version of LLVM. Comments, docstrings and line numbers of kernels
    are not part of it.
    """
    config: Any = numba.config
    settings = (llvmlite.__version__, config.BOUNDSCHECK, config.OPT, config.USING_SVML)
    digest = hashlib.sha256(repr(settings).encode())
    reached: dict[int, Any] = {}
    waiting = [kernel]
    while waiting:
        own = waiting.pop()
        if id(own) not in reached:
            reached[id(own)] = own
            text, called = _own_facts(own)
            digest.update(text)
            waiting.extend(called)
    return digest.hexdigest()


_facts: dict[int, tuple[bytes, list[Any]]] = {}  # id of a kernel -> what _own_facts found; kernels live as long as we


def _own_facts(kernel: Any) -> tuple[bytes, list[Any]]:
    """Return the digest of one kernel by itself, and the kernels that it calls, in the order of their names."""
    if id(kernel) not in _facts:
        function: FunctionType = kernel.py_func
        options = sorted((name, _stable(value)) for name, value in kernel.targetoptions.items())
        facts: list[object] = [function.__module__, function.__qualname__, options]
        called: list[Any] = []
        names = _read_code(function.__code__, function.__doc__, facts)
        for name in sorted(names):
            if name in function.__globals__:
                facts.append(name)
                _read_value(function.__globals__[name], names, facts, called)
        for value in (*(cell.cell_contents for cell in function.__closure__ or ()), *(function.__defaults__ or ())):
            _read_value(value, names, facts, called)
        _facts[id(kernel)] = hashlib.sha256(repr(facts).encode()).digest(), called
    return _facts[id(kernel)]


def _read_code(code: CodeType, docstring: str | None, facts: list[object]) -> set[str]:
    """Append the byte code and its constants to ``facts``; return the names of globals and attributes that it reads."""
    names = set(code.co_names)
    facts += [code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_flags]
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a nested function, or a comprehension
            names |= _read_code(constant, None, facts)
        elif constant is None or constant != docstring:
            facts.append((type(constant).__name__, _stable(constant)))
    return names


def _stable(value: object) -> str:
    """Return a text of ``value`` that is the same in every process: sets are sorted."""
    return repr(sorted(value, key=repr) if isinstance(value, set | frozenset) else value)


def _read_value(value: Any, names: set[str], facts: list[object], called: list[Any]) -> None:
    """Append to ``facts`` what of a global ``value`` goes into machine code; kernels go to ``called`` instead."""
    if isinstance(value, Dispatcher):
        called.append(value)
    elif isinstance(value, enum.EnumMeta):
        facts.append(repr(dict(value.__members__)))
    elif isinstance(value, np.ndarray):
        facts.append((value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()))
    elif isinstance(value, tuple | list):
        for each in value:
            _read_value(each, names, facts, called)
    elif isinstance(value, ModuleType):
        facts.append(value.__name__)
        if value.__name__.partition(".")[0] not in ("numpy", "numba", "math"):
            for name in sorted(names & set(vars(value))):
                _read_value(getattr(value, name), names, facts, called)
    elif isinstance(value, type) or callable(value):
        # Not a kernel: an intrinsic or an overload, which only the whole file that defines it describes.
        definition = getattr(value, "_defn", value)
        module = str(getattr(definition, "__module__", None))
        facts.append((module, str(getattr(definition, "__qualname__", definition))))
        if module.partition(".")[0] not in ("numpy", "numba", "builtins", "math", "operator"):
            facts.append(_file_digest(getattr(sys.modules.get(module), "__file__", None)))
    else:
        facts.append((type(value).__name__, _stable(value)))


@cache
def _file_digest(path: str | None) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""
    except OSError:  # in a zip file, or gone
        return ""
