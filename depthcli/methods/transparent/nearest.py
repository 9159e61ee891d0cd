"""The K nearest of scattered samples, for any pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange


def nearest_samples(
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    shape: tuple[int, int],
    at: tuple[NDArray[np.int32], NDArray[np.int32]],
    count: int,
    skip_own: bool = False,
) -> NDArray[np.int32]:
    """Indices of the samples nearest to pixels, the nearest first; of equally near ones the earlier first.

    Parameters
    ----------
    rows, columns : (M,) int32 pixels of the samples, inside ``shape``
    shape : (H, W)
    at : (P,) int32 rows and columns of the pixels
    count : K
    skip_own : a sample that lies on the pixel itself does not count

    Returns
    -------
    (P, K) int32; -1 where there are fewer
    """
    height, width = shape
    # Cells that hold about two samples each.
    side = max(1, int(np.sqrt(2.0 * height * width / max(1, rows.size))))
    across, down = -(-width // side), -(-height // side)
    cell = (rows // side).astype(np.int64) * across + columns // side
    order = np.argsort(cell, kind="stable").astype(np.int32)
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=across * down))]).astype(np.int64)
    found = np.full((at[0].size, count), -1, np.int32)
    _nearest(rows[order], columns[order], order, first, side, across, down, at[0], at[1], skip_own, found)
    return found


@parallel_jit
def _nearest(
    rows: Any, columns: Any, order: Any, first: Any, side: int, across: int, down: int, at_rows: Any,
    at_columns: Any, skip_own: bool, found: Any,
) -> None:  # fmt: skip
    count = found.shape[1]
    for p in prange(at_rows.size):
        y, x = at_rows[p], at_columns[p]
        cy, cx = y // side, x // side
        best = np.full(count, np.int64(1) << np.int64(62), np.int64)
        have = 0
        ring = 0
        while ring <= max(across, down):
            for v in range(max(0, cy - ring), min(down, cy + ring + 1)):
                step = 1 if abs(v - cy) == ring else max(1, 2 * ring)
                for u in range(cx - ring, cx + ring + 1, step):
                    if u < 0 or u >= across:
                        continue
                    for s in range(first[v * across + u], first[v * across + u + 1]):
                        dy, dx = np.int64(rows[s] - y), np.int64(columns[s] - x)
                        far = dy * dy + dx * dx
                        if skip_own and far == 0:
                            continue
                        # Distance and index in one number, so that ties have an order.
                        have = _insert(best, have, (far << np.int64(31)) | np.int64(order[s]))
            # Whatever lies in a further ring is at least this far away.
            reach = np.int64(ring * side + min(min(y - cy * side, cy * side + side - 1 - y),
                                               min(x - cx * side, cx * side + side - 1 - x)) + 1)  # fmt: skip
            if have == count and (best[count - 1] >> np.int64(31)) < reach * reach:
                break
            ring += 1
        for k in range(have):
            found[p, k] = np.int32(best[k] & np.int64(0x7FFFFFFF))


@jit
def _insert(best: Any, have: int, key: Any) -> Any:
    count = best.size
    if have == count and key >= best[count - 1]:
        return have
    at = min(have, count - 1)
    while at > 0 and best[at - 1] > key:
        best[at] = best[at - 1]
        at -= 1
    best[at] = key
    return min(have + 1, count)
