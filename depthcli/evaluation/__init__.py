"""Comparison of runs with ground truth: maps of the runs and scenes with truth in, scores, tables and plots out.

``evaluate.evaluate_runs`` does it all, from folders to files; arrays hold NaN where they have no value:

1. ``map_files`` names the runs, and the places where a run folder may hold the map of a scene.
2. A protocol (``protocols``, one file per benchmark or kind of truth) reads the scene's truth, once, and the run's map:
   (H, W) float32 disparities in pixels, (H, W) float32 depths in meters, or (N,) float32 errors in millimeters at
   points of a volume.
3. It scores the map by region (``nonocc``, ``all`` ...): a ``Score`` (``scores``) for every metric, and the
   sparsification ``curves`` of the confidence maps. All that is known of one map is a ``MapResult``.
4. ``comparison``: a ``Section`` holds the results of one data set under one protocol, with means and ranks by the
   protocol's rule and the tests of ``statistics``; an ``EvaluationReport`` all sections.
5. ``tables`` arranges the numbers, ``render`` writes any table as text, Markdown, LaTeX, CSV or HTML, ``plots`` draws.
   A protocol's words, units and colors are its ``Presentation``. The page and the contact sheet (room ``report``) are
   viewers, which get the maps while they are scored.

``benchmarks`` stands apart: which files a submission to a benchmark holds. Begin with
``protocols/middlebury_v2.py``, the shortest protocol.

======================  ============================================================================================
``nonocc``, ``noc``     pixels that both views see; ``occ`` (KITTI): all pixels; ``disc``: near depth discontinuities
``bad``, ``out``        share of pixels whose error is above a threshold; ``totbad``: or that have no value
``D1``                  KITTI 2015: error above 3 px and at least 5 % of the true disparity
``est``                 KITTI: over the pixels that the map has a value for, not over the interpolated map
``A50`` ...             quantiles of the error
``avgerr``, ``MAE``     mean absolute error; ``rms``, ``RMSE``: root of the mean squared error
``REL``                 mean of error / true depth
``delta``               share of pixels whose ratio to the truth is below a limit
AUC                     area under a sparsification curve; of registration points: under the ROC curve
AUSE, AURG              distance of a sparsification curve to the optimal and to a random one
``TRE``                 target registration error, the true error at a point; ``TRE30``: mean of the worst 30 %
======================  ============================================================================================
"""
