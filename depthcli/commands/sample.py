"""Generate scenes with exact ground truth.

Without the name of a kind these are stereo pairs; options of another kind are errors.

Examples:
  depthcli sample --output scenes --count 4 --noise 2
  depthcli sample --kinect --output frames
"""

from __future__ import annotations

from dataclasses import fields

from depthcli.commands._options import RunOptions, SampleOptions


def sample(run: RunOptions, scenes: SampleOptions) -> int:
    """Generate the scenes of one kind into a run folder."""
    from depthcli.commands._batch import run_batch
    from depthcli.problems.sample import sampled

    return run_batch(*sampled(vars(scenes), {option.name: option.default for option in fields(scenes)}), run)
