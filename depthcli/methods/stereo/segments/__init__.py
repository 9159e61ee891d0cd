"""Segment-based stereo (thesis, chapter 2): matching costs in, a map with one plane per segment out.

| module | step, with its part of the config |
|---|---|
| ``steps`` | the data flow of all steps, where to start |
| ``ranges`` | matched key points -> disparities that their segment may have |
| ``first_estimate`` | costs -> means over windows inside segments -> first disparities, and which are trusted |
| ``segmented_image`` | labels, first disparities -> segments and their neighbors, those that are not planar cut |
| ``energy`` | planes, segments -> costs of a plane in a segment, and of different planes in neighbors |
| ``assignment`` | segments -> planes that they may lie on -> one plane for every segment, by graph cuts |
| ``outputs`` | the finished map, figures, tables and pictures |
"""

from __future__ import annotations

from depthcli.core.method import ConfigModel


class Step(ConfigModel):
    """Base of the steps: a callable with its parameters."""
