"""What the columns of a run's report mean: of ``report.csv``, ``report.json`` and the table that a command prints."""

from __future__ import annotations

from depthcli.core.columns import ColumnHelp as Column

REPORT = (
    Column("scene", "name of the scene"),
    Column("status", "done, skipped, or failed"),
    Column("error", "why it failed"),
    Column("width, height", "size of the map", "px", ("size",), "width|height|slices"),
    Column("density", "share of pixels that have a value", "0 to 1, printed %"),
    Column("seconds_STAGE", "computing time of a stage; the printed table has their sum", "s", ("seconds",),
           "seconds_.*"),
    Column("peak_memory", "largest memory of the process while it computed the scene", "bytes, printed MiB",
           ("memory",)),
    Column("program_cpu", "processor time of a program, and of what it starts", "s"),
    Column("program_memory", "largest memory of a program and of what it starts", "bytes"),
    Column("source", "first input file"),
)  # fmt: skip
"""Columns of every command that writes a run folder."""

MAPS = (
    Column("measured", "share of pixels whose value was matched, not filled", "0 to 1, printed %"),
    Column("min_disparity, max_disparity", "ends of the search range", "px", pattern="(min|max)_disparity"),
    Column("range_matches", "number of key points that the search range was found by"),
    Column("range_low, range_top", "search range that the key points suggest", "px", pattern="range_(low|top)"),
    Column("bits", "bits of the images' samples that are in use, where fewer than stored"),
    Column("device", "what the scene was matched on"),
    Column("matches", "matched key points of both views"),
    Column("row_error_before", "median distance of the rows of matched key points, of the images as taken", "px",
           ("row error before",)),
    Column("row_error", "median distance of the rows of matched key points after the rectification", "px",
           ("row error",)),
    Column("overlap", "share of the left view's pixels that the right camera can see", "0 to 1, printed %"),
    Column("tiles", "number of tiles that the pair was matched in"),
    Column("levels", "number of sizes that the pair was matched at"),
    Column("exact", "1: the tiles give the same map as the whole pair; 0: they need not"),
    Column("stages_on_cpu", "stages without an implementation for the device"),
    Column("segments", "number of segments of the left image"),
    Column("keypoints", "matched key points that widened or narrowed the search range"),
    Column("trusted", "share of pixels whose first estimate passed the checks", "0 to 1"),
    Column("planes", "number of planes that segments could take"),
    Column("planes_used", "number of planes that segments took"),
    Column("energy_before, energy", "energy of the assignment of planes, before and after its optimization",
           pattern="energy(_before)?"),
    Column("weight_N", "mean weight of a fused volume, or of a color channel (r, g, b)", pattern="weight_.*"),
)  # fmt: skip
"""Columns of ``stereo``, ``fuse`` and ``rectify``."""

DEPTH = (
    Column("known", "share of pixels where the sensor has a value", "0 to 1, printed %"),
    Column("registered", "where the depth was brought to the color image's pixels: by both cameras, or assumed: it was "
           "only scaled"),
    Column("sparse", "share of pixels with a sparse second measurement", "0 to 1"),
    Column("kept", "share of pixels that keep the sensor's value, smoothed or not", "0 to 1, printed %"),
    Column("filled", "share of pixels that had no value and got one", "0 to 1, printed %"),
    Column("corrected", "share of pixels whose value was judged wrong and replaced", "0 to 1, printed %",
           ("replaced",)),
    Column("from_stereo", "share of filled or replaced pixels' area whose value stereo confirms", "0 to 1",
           ("from stereo",)),
    Column("shadow_width_left, shadow_width_right", "measured width of shadows per step beside them", "px per px",
           pattern="shadow_width_(left|right)"),
    Column("shadows_left, shadows_right", "confidence that gaps on that side of near surfaces are shadows", "0 to 1",
           pattern="shadows_(left|right)"),
    Column("gap_filled, fallback, carried, empty, smoothed", "share of pixels with that bit of status.png",
           "0 to 1", pattern="gap_filled|fallback|carried|empty|smoothed"),
    Column("frames, frames_failed", "frames of a sequence that were refined, and that failed",
           pattern="frames(_failed)?"),
    Column("motion", "of the camera, frame by frame: still, by its pose, estimated, or new (nothing was carried over)"),
    Column("labelled", "share of pixels that the CRF chose a depth for", "0 to 1"),
    Column("samples", "measurements that the model was fitted to"),
    Column("noise", "noise of the measurements, estimated", "m"),
    Column("matched", "share of pixels with a depth by cross-modal stereo", "0 to 1"),
    Column("median_depth", "median depth", "m", ("median depth",)),
    Column("focal", "focal length", "px"),
    Column("baseline", "distance of the cameras", "m"),
    Column("doffs", "difference of the principal points' columns, right - left", "px"),
    Column("beyond_png", "share of the depths that depth.png cannot hold", "0 to 1", ("beyond png",)),
    Column("points", "number of points of the cloud"),
)  # fmt: skip
"""Columns of ``refine-kinect``, ``transparent`` and ``depth``."""

REGISTRATION = (
    Column("iso", "edge of a voxel of the grid that is searched; none with pipeline: command", "mm"),
    Column("border", "share of the voxels whose best match lies on the border of the search, if there is one",
           "0 to 1, printed %", ("at border",)),
    Column("mean_error", "mean expected error, without a mask that of air too; of samples the mean true error", "mm",
           ("expected mm",)),
    Column("inside_mean", "mean expected error within the mask, or else within the body", "mm", ("mean mm",)),
    Column("inside_95", "expected error that 95 % of the voxels in the mask or body stay below", "mm",
           ("95 % mm", "expected_error_p95")),
    Column("region_mean_NAME, region_95_NAME", "mean expected error in a region, and its 95 % quantile", "mm",
           pattern="region_(mean|95)_.+"),
    Column("region_volume_NAME", "size of a region", "mL", pattern="region_volume_.+"),
    Column("region_error_NAME", "why mask_NAME could not be used", pattern="region_error_.+"),
    Column("inside_max", "largest expected error in the mask or body", "mm", ("largest mm",)),
    Column("above_3mm", "volume of the mask or body whose expected error is above 3 mm", "mL", ("above 3 mm, mL",)),
    Column("above_x, above_y, above_z", "center of the largest connected region above 3 mm; towards left, posterior, "
           "superior (LPS)", "mm", ("center, LPS",), "above_[xyz]"),
)  # fmt: skip
"""Columns of ``register-confidence``."""

GIVEN_MAPS = (
    Column("max_disparity", "largest disparity whose costs were compared", "px"),
    Column("maps", "number of maps that were fused"),
    Column("expected_right", "mean probability that a value is right", "0 to 1, printed %", ("expected right",)),
    Column("hidden", "share of pixels that the right view does not see", "0 to 1, printed %"),
    Column("measured", "share of pixels that are visible in both views and likely right", "0 to 1, printed %"),
)
"""Columns of ``confidence`` and ``fuse-maps``."""

SAMPLES = (
    Column("nonocc", "share of the left view's pixels that the right view sees", "0 to 1, printed %", ("visible",)),
)
"""Columns of ``sample``, beside those of the commands that read its scenes."""

OF_RUNS = (*REPORT, *MAPS, *DEPTH, *REGISTRATION, *GIVEN_MAPS, *SAMPLES)
"""Columns of the reports of all runs."""

SEGMENTS = (
    Column("plane", "number of a plane"),
    Column("a, b, c", "disparity of the plane at (x, y): a x + b y + c, px", pattern="[abc]"),
    Column("support", "pixels that the plane was fitted to"),
    Column("segments", "segments that took the plane"),
    Column("segment", "number of a segment, as in segments.png"),
    Column("pixels", "size of the segment", "px"),
    Column("trusted", "its pixels whose first estimate passed the checks", "px"),
    Column("lowest, highest", "search range of the segment", "px", pattern="lowest|highest"),
    Column("x, y", "place of a key point in the left image", "px", pattern="[xy]"),
    Column("disparity", "of the key point", "px"),
    Column("distance", "of the descriptors of both views; smaller is surer"),
)
"""Columns of ``planes.csv``, ``segment_labels.csv`` and ``keypoints.csv`` of the pipeline ``segments``."""

LISTS = (
    Column("device", "name of a device for --set device"),
    Column("name", "as its driver calls it"),
    Column("memory", "of the device; of a scene: estimated peak of its computation"),
    Column("bandwidth", "measured speed of copies in its memory", "GB/s"),
    Column("driver", "version of the driver"),
    Column("kernel", "compiled function"),
    Column("arguments", "types that it is compiled for"),
    Column("done", "scenes of a run that are done"),
)
"""Columns of ``devices`` and ``--dry-run``, beside those of a report."""
