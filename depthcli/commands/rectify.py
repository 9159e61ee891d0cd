"""Rectify image pairs, with or without a calibration.

Each scene gets the rectified pair, its calibration calib.txt, and the search range that matched key points suggest.

Examples:
  depthcli rectify --input photos --calibration stereo.yaml --output rectified
  depthcli rectify --left l.jpg --right r.jpg --uncalibrated --output pair
"""

from __future__ import annotations

from depthcli.commands._options import PairOptions, RectifyOptions, RunOptions


def rectify(pairs: PairOptions, how: RectifyOptions, run: RunOptions) -> int:
    """Rectify every pair; return the exit code."""
    from depthcli.commands._run import find_scenes, run_job
    from depthcli.io.scenes.pairs import PAIRS
    from depthcli.problems.rectify import rectifier

    return run_job(rectifier(how.uncalibrated, how.settings()), find_scenes(PAIRS, pairs, run), run, pairs)
