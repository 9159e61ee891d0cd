"""Refinement of Kinect depth maps: gaps filled, depth edges moved to color edges, noise smoothed (thesis chapter 4).

In: an ``RgbdFrame``, color and depth. Out: a ``RefinedDepth`` with depth, status and standard deviation. In between all
pipelines compute with the sensor's disparity, in pixels, which is proportional to inverse depth: ``disparity`` has
what they begin and end with (measured disparity, its noise, the way back to depth).

| pipeline, one file each in ``pipeline`` | steps, in order (module: decision) |
|---|---|
| ``plane_votes``, the most accurate | 1. ``outlines``: which measurements are correct. 2. Planes through windows of \
these (``algorithms.plane_fitting.window_planes``). 3. ``shadows``: which surfaces a gap allows. 4. ``plane_voting``: \
candidates for the other pixels. 5. ``candidate_choice``: which candidate |
| ``dsrm``, of the thesis | 1. ``depth_edges``: which measurements are unreliable. 2. Layers of segments, from fine to \
coarse (``algorithms.segmentation``). 3. ``model``: a surface for each segment. 4. ``surfaces``: which neighbor a \
segment without one joins. 5. ``layers``: median of the layers, and which measurements it replaces |
| ``sequence`` | as ``dsrm``, but segments and surfaces are carried from frame to frame |
| ``shadow_smoother``, at video rate | 1. ``depth_edges`` and ``shadows``: confidence of each pixel. 2. Smoothing |
| the others | filters of libraries, for comparison |
"""
