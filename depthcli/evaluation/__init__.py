"""Comparison of runs with ground truth: maps of the runs and scenes with truth in, scores out.

``evaluate.scenes_with_truth`` finds the scenes, ``evaluate_runs`` does the rest; arrays have NaN for no value:

1. ``map_files`` names the runs, and the places where a run folder may have the map of a scene.
2. A protocol (``protocols``, one file per benchmark or kind of truth) reads the scene's truth, once, and the run's map:
   (H, W) float32 disparities in pixels, (H, W) float32 depths in meters, or (N,) float32 errors in millimeters at
   points of a volume.
3. It scores the map by region (``nonocc``, ``all`` ...): a ``Score`` (``scores``) for every metric, and the
   sparsification ``curves`` of the confidence maps. All that is known of one map is a ``MapResult``.
4. ``comparison``: a ``Section`` has the results of one data set under one protocol, with means and ranks by the
   protocol's rule and the tests of ``statistics``; an ``EvaluationReport`` all sections.
5. Tables, plots, page and contact sheet are made in the room ``report``, by viewers, which get the maps while they
   are scored. A protocol's words, units and colors are its ``Presentation``.

``bounds`` scores error bounds, ``sweeps`` compares the runs of ``sweep``, and ``benchmarks`` writes the files of a
submission to a benchmark. Begin with ``protocols/booster.py``, the shortest protocol; ``report.terms`` explains all
metrics and regions.
"""
