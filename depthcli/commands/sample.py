"""Write scenes with ground truth, generated or real.

By default the scenes are stereo pairs. Options for another kind of scene are rejected. ``--real`` downloads nothing:
the pair is part of scikit-image.

Examples:
  depthcli sample --real --output real
  depthcli sample --output scenes --count 4 --noise 2
  depthcli sample --kinect --output frames
"""

from __future__ import annotations

from dataclasses import fields

from depthcli.commands._options import RunOptions, SampleOptions


def sample(run: RunOptions, scenes: SampleOptions) -> int:
    """Write the scenes of one kind into a run folder."""
    from depthcli.commands._run import run_job
    from depthcli.problems.sample import sampled

    return run_job(*sampled(vars(scenes), {option.name: option.default for option in fields(scenes)}), run)
