"""Errors whose message is meant for the user: one line saying what, where, and what to do."""

from __future__ import annotations

from depthcli.core.text import printable, without_secrets


class DepthcliError(Exception):
    """Base of the errors a command reports without a traceback. The message can always be printed and encoded.

    Queries and passwords of URLs stay out of it, as reports hold it.
    """

    def __str__(self) -> str:
        return without_secrets(printable(super().__str__()))


class InputError(DepthcliError):
    """An image or data file is missing, damaged, or of the wrong kind."""


class ConfigError(DepthcliError):
    """A config file or option is wrong."""


class OutputError(DepthcliError):
    """A result cannot be written."""


class IncompleteError(DepthcliError):
    """Results stand in their files, but the report or the data for stdout cannot be written."""
