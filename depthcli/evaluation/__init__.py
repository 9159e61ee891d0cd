"""Comparison of runs with ground truth: from maps and scenes with ground truth to scores.

``evaluate.scenes_with_truth`` finds the scenes, ``evaluate_runs`` does the rest. In arrays, NaN means no value.

1. ``map_files`` names the runs, and the places where a run folder may have the map of a scene.
2. A protocol (``protocols``, one file per benchmark or kind of truth) reads the scene's truth, once, and the run's map:
   (H, W) float32 disparities in pixels, (H, W) float32 depths in meters, or (N,) float32 errors in millimeters at
   points of a volume.
3. It scores the map by region (``nonocc``, ``all`` ...): a ``Score`` (``scores``) for every metric, and the
   sparsification ``curves`` of the confidence maps. A ``MapResult`` has all data of one map.
4. ``comparison``: a ``Section`` has the results of one data set under one protocol, with means and ranks by the
   protocol's rule and the tests of ``statistics``; an ``EvaluationReport`` has all sections.
5. The package ``report`` makes tables, plots, page and contact sheet, by viewers that get the maps while they are
   scored. A protocol's words, units and colors are its ``Presentation``.

``bounds`` scores error bounds, ``sweeps`` compares the runs of ``sweep``, and ``benchmarks`` writes the files of a
submission to a benchmark. Begin with ``protocols/booster.py``, the shortest protocol; ``report.terms`` explains all
metrics and regions.
"""
