"""Kinect depth maps: gaps filled, depth edges moved to the color edges, noise smoothed (thesis chapter 4).

Every pipeline works on the sensor's disparity, in pixels, which is proportional to inverse depth. ``disparity``
has what all begin and end with: the measured disparity of a frame, its noise, and the way back to depth.

``dsrm``, the thesis's method: ``depth_edges`` marks measurements on the near side of depth edges as unreliable;
``algorithms.segmentation`` gives layers of segments, from fine to coarse; ``model`` fits a surface to every segment,
``surfaces`` lets segments without one join a neighbor that fits the shadow they lie in (``shadows``) and adds detail;
``layers`` takes the median of the layers and decides what becomes of every measurement. ``sequence`` carries
segments from frame to frame.

``plane_votes``, the most accurate: ``outlines`` gives the probability of every measurement, planes are fitted to the
windows of reliable ones (``algorithms.plane_fitting.window_planes``); ``plane_voting`` collects their votes for
unreliable pixels, weighted by color, distance and what ``shadows`` allow, ``candidate_choice`` selects among them.

``shadow_smoother``, at video rate, and the other pipelines: library filters, for comparison.
"""
