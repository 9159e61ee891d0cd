"""Refinement of Kinect depth maps: gaps filled, depth edges moved to color edges, noise smoothed (thesis, chapter 4).

In: an ``RgbdFrame``, color (H, W, 3) uint8 and depth (H, W) float32, m. Out: a ``DepthResult`` with depth and status.
Start at ``pipeline``: one file per pipeline, its steps in order. ``bounds`` computes error bounds for the result of any
pipeline. All pipelines compute with the sensor's disparity in pixels, which is proportional to inverse depth.
``disparity`` has their first and last steps: the measured disparity, its noise, and the conversion back to depth.

A sensor shows near surfaces too wide and leaves *shadows*, gaps on the far side of a step. ``shadows`` measures their
side and width in each frame. Without a color image the true outlines are unknown.

In all modules ``disparity`` is (H, W) float32, in pixels, NaN = unknown; ``color`` is (H, W, 3) uint8 RGB; ``lab`` is
the color image in CIE Lab with OpenCV's scaling; ``labels`` is (H, W) int32; ``noise`` is the standard deviation of the
measured disparity, in pixels; ``jump`` is the smallest step that counts as a depth edge, in pixels; ``shadows`` are the
measured shadows.

| pipeline | steps, in order (module: decision) |
|---|---|
| ``plane_votes``, the most accurate | 1. ``depth_edges`` and ``candidates.hidden_openings``: which measurements are \
correct. 2. Planes through windows of these (``algorithms.plane_fitting.window_planes``). 3. ``gap_limits`` and \
``gap_filling``: which surfaces a gap allows, and the likeliest one. 4. ``candidates`` for the other pixels, from \
the planes' votes. 5. ``candidates.choose_candidates``: which candidate |
| ``dsrm``, of the thesis (depth-guided segments, robust model) | 1. ``disparity.Measurement``: which measurements are \
unreliable. 2. Segments, from fine to coarse (``algorithms.segmentation``). 3. ``layers``: a surface for each segment, \
the neighbor that a segment without a surface joins, and the detail that surfaces leave out; then the median of the \
segmentations, and which measurements it replaces. 4. ``gap_filling`` along paths |
| ``sequence`` | like ``dsrm``, but segments and surfaces are carried from frame to frame by ``camera_motion`` |
| ``shadow_smoother``, at video rate | 1. ``depth_edges``, ``gap_limits`` and ``gap_filling``: a value and its \
confidence for each pixel. 2. Smoothing |
| the others | filters of libraries, for comparison |
"""
