"""Status maps: one-channel 8-bit PNGs of status codes, and the text that explains the codes."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import without_smoothed
from depthcli.io.formats.files import naming, read_bytes, write_bytes, write_text
from depthcli.io.formats.images import decode_bits
from depthcli.show.view import MEASURED_CODE, Palette, status_words


class StatusMap(np.ndarray[Any, np.dtype[np.uint8]]):
    """(H, W) uint8: the codes of a status map, bits of ``Status`` or ``DepthStatus``."""

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool, True for measured pixels (code 0)."""
        measured: NDArray[np.bool_] = np.asarray(self) == 0
        return measured


def write_status(path: Path | str, status: NDArray[np.uint8]) -> None:
    """Write (H, W) uint8 codes as a one-channel 8-bit PNG for :func:`read_status`."""
    from PIL import Image

    if status.ndim != 2 or status.dtype != np.uint8:
        raise ValueError(f"expected (H, W) uint8, got {status.shape} {status.dtype}")
    file = BytesIO()
    picture = Image.frombytes("L", status.shape[::-1], np.ascontiguousarray(status).tobytes())
    # For these files of few codes, run lengths compress as well as a search for repetitions, in 1/7 of the time.
    picture.save(file, "PNG", compress_level=1, compress_type=zlib.Z_RLE)
    write_bytes(path, file.getvalue())


def read_status(path: Path | str) -> StatusMap:
    """Return the codes of ``status.png``, (H, W) uint8, with ``measured``. Raise InputError if it cannot be read.

    Files of versions up to 0.2.0 have a palette and bit 32, "smoothed", which is removed.

    Examples
    --------
    >>> import depthcli
    >>> depthcli.read_status("run/scene/status.png").measured.mean()  # doctest: +SKIP
    """
    data = read_bytes(path)
    with naming(path):
        return without_smoothed(decode_bits(data)).view(StatusMap)


def write_codes(path: Path | str, palette: Palette, values: Iterable[int] | None = None) -> None:
    """Write the text that explains the codes of status maps; the default ``values`` are 0 and each single bit."""
    codes = sorted(set(palette if values is None else map(int, values)))
    rows = [f"{code:3d}  {status_words(code, palette)}" for code in codes]
    write_text(path, "\n".join(["Codes of status.png, sums of bits:", *rows, "", MEASURED_CODE, ""]))
