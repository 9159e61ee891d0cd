"""Errors whose message is meant for the user: one line saying what, where, and what to do."""

from __future__ import annotations

import re

from depthcli.core.text import printable

_URL_AS_PATH = re.compile(r"\b(https?|s3|gs|ftp|memory):/(?=[^/\s])")  # paths have one slash of the two


class DepthcliError(Exception):
    """Base of the errors a command reports without a traceback. The message can always be printed and encoded."""

    def __str__(self) -> str:
        return _URL_AS_PATH.sub(r"\1://", printable(super().__str__()))


class InputError(DepthcliError):
    """An image or data file is missing, damaged, or of the wrong kind."""


class ConfigError(DepthcliError):
    """A config file or option is wrong."""


class OutputError(DepthcliError):
    """A result cannot be written."""


class IncompleteError(DepthcliError):
    """Results stand in their files, but the report or the data for stdout cannot be written."""
