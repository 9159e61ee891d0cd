"""Disparity maps that have to be right to an eighth of a pixel."""

from __future__ import annotations

from dataclasses import replace

from depthcli.evaluation.protocols.eth3d import Eth3dProtocol


class EighthPixel(Eth3dProtocol):
    """ETH3D's scores, of which the share of errors above an eighth of a pixel ranks the runs."""

    presentation = replace(Eth3dProtocol.presentation, title="Eighth of a pixel: bad pixels, %")
    thresholds = (0.125, 1.0)
    default_threshold = 0.125
