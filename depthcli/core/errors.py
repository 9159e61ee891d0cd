"""Errors whose message is meant for the user: one line saying what, where, and what to do."""

from __future__ import annotations


class DepthcliError(Exception):
    """Base of the errors a command reports without a traceback. The message can always be printed and encoded."""

    def __str__(self) -> str:
        return printable(super().__str__())


class InputError(DepthcliError):
    """An image or data file is missing, damaged, or of the wrong kind."""


class ConfigError(DepthcliError):
    """A config file or option is wrong."""


class OutputError(DepthcliError):
    """A result cannot be written."""


class IncompleteError(DepthcliError):
    """Results stand in their files, but the report or the data for stdout cannot be written."""


def printable(text: str) -> str:
    """``text`` with escapes for what cannot be shown: control characters, bytes of names that are not UTF-8.

    Line breaks stay. Python holds such bytes as lone surrogates, which no stream takes.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else _escape(c) for c in text)


def _escape(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:
        return f"\\x{code - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")
