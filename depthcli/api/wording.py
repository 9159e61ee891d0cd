"""Messages as Python's callers read them: keywords in the place of options of the command line."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec, TypeVar

from depthcli.core.errors import DepthcliError

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

_COMMAND_ONLY = re.compile(r"(?:, )?--(?:max-memory|jobs)(?=[,;]|$)")  # Python takes what memory is free
_REPLACEMENTS = (
    (_COMMAND_ONLY, ""),
    (re.compile(r"; see ?$"), ""),
    (re.compile(r"; see ?, "), "; see "),
    (re.compile(r"--set "), ""),
    (re.compile(r"--plugin FILE\.py"), "plugins=['FILE.py']"),
)
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*[a-z])")


def in_python(text: str) -> str:
    """Return a message with the names of keywords where it names options.

    >>> in_python("4 GiB are needed; see --max-memory, --jobs, --max-disparity")
    '4 GiB are needed; see max_disparity'
    """
    for pattern, replacement in _REPLACEMENTS:
        text = pattern.sub(replacement, text)
    return _OPTION.sub(lambda found: found[1].replace("-", "_"), text)


def worded(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Make a function raise its errors, and return its ``warnings``, in the words of :func:`in_python`."""

    @wraps(function)
    def call(*arguments: _Arguments.args, **keywords: _Arguments.kwargs) -> _Result:
        try:
            result = function(*arguments, **keywords)
        except DepthcliError as error:
            text = in_python(str(error))
            if text == str(error):
                raise
            raise type(error)(text) from error
        given = getattr(result, "warnings", ())
        warnings = tuple(map(in_python, given))
        return result if warnings == given else replace(result, warnings=warnings)  # type: ignore[type-var]

    return call
