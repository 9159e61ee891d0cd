"""Warnings of many scenes."""

from __future__ import annotations

import pytest

from depthcli.run.console import Reporter
from depthcli.run.warning_counts import WarningCounts


def test_a_warning_of_many_scenes_is_printed_once_with_their_number(capsys: pytest.CaptureFixture[str]):
    counts = WarningCounts(Reporter(0))
    for k in range(90):
        counts.add(f"{k:04}", [f"/in/{k:04}/depth.png: the median depth is {k / 7} m; see --depth-scale"])
    counts.add("0000", ["odd", "even 1", "even 2"])
    counts.close()
    assert capsys.readouterr().err.splitlines() == [
        "0000: warning: /in/0000/depth.png: the median depth is 0.0 m; see --depth-scale",
        "0000: warning: odd",
        "0000: warning: even 1",
        "0000: warning: even 2",
        "warning: the median depth is 0.0 m; see --depth-scale (90 scenes; -v names each)",
    ]
