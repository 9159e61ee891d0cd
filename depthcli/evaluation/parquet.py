"""The long form of an evaluation as a Parquet file, by pyarrow, an extra (``depthcli[parquet]``) imported here only."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from depthcli.core.errors import ConfigError
from depthcli.evaluation.results import COLUMNS, Record

_FLOATS, _INTEGERS = ("threshold", "value", "density"), ("wrong", "pixels")


def check_parquet() -> None:
    """Raise ConfigError where pyarrow is not installed."""
    _pyarrow()


def parquet_bytes(records: Sequence[Record], facts: Mapping[str, object]) -> bytes:
    """Return the rows of ``scores.csv`` as a Parquet file, the same bytes for the same rows and pyarrow.

    Thresholds, values and densities are ``float64``, counts of pixels ``int64``, both null where there is no number;
    all other columns are text, empty where there is nothing to say.

    Parameters
    ----------
    facts : name -> value, in the file's metadata as ``depthcli.NAME``; what is no text, as JSON

    Raises
    ------
    ConfigError
        pyarrow is not installed.
    """
    arrow, parquet = _pyarrow()
    rows = [record.row() for record in records]
    fields = [arrow.field(name, *_type(arrow, name)) for name in COLUMNS]
    texts = {f"depthcli.{k}": v if isinstance(v, str) else json.dumps(v, sort_keys=True) for k, v in facts.items()}
    schema = arrow.schema(fields, {name: _utf8(text) for name, text in texts.items()})
    columns = [arrow.array([_cell(name, row[name]) for row in rows], schema.field(name).type) for name in COLUMNS]
    file = io.BytesIO()
    parquet.write_table(arrow.Table.from_arrays(columns, schema=schema), file, compression="zstd")
    return file.getvalue()


def _type(arrow: Any, name: str) -> tuple[Any, bool]:
    """The type of a column, and whether its cells may be null."""
    if name in _FLOATS:
        return arrow.float64(), True
    return (arrow.int64(), True) if name in _INTEGERS else (arrow.string(), False)


def _cell(name: str, value: Any) -> Any:
    if name in _FLOATS:
        return None if value == "" or not math.isfinite(value) else float(value)
    if name in _INTEGERS:
        return None if value == "" else int(value)
    return _utf8(str(value))


def _utf8(text: str) -> str:
    """The text with bytes of file names that are not UTF-8 escaped, as in ``scores.csv``."""
    return text.encode("utf-8", "backslashreplace").decode()


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError("--parquet wants pyarrow: pip install 'depthcli[parquet]'") from None
    return pyarrow, pyarrow.parquet
