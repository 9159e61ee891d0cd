"""Meaning of the columns of an evaluation: scores by metric and region, and the other columns of every table."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """A heading of a column, explained."""

    name: str  # the heading; of columns that differ in a number or name, with that in capitals, such as ``bad T``
    about: str  # one line: the meaning of the numbers
    unit: str = ""
    also: tuple[str, ...] = ()  # other headings of the same numbers, such as in the printed table
    pattern: str = ""  # regular expression of all headings, if ``name`` is for several

    @property
    def headings(self) -> str:
        """Name, other headings and unit, as a list of columns shows them."""
        unit = f" [{self.unit}]" if self.unit else ""
        return ", ".join((self.name, *self.also)) + unit

    def fits(self, heading: str) -> bool:
        """Return whether a heading, without its unit after a comma, names this column."""
        return heading in (self.name, *self.also) or bool(self.pattern and re.fullmatch(self.pattern, heading))


METRICS = (
    Term("bad T", "share of pixels whose error is above T px; the protocol decides whether missing pixels count", "%",
         pattern=r"bad [\d.]+( \([\d.]+\)| px)?"),
    Term("totbad T", "share of pixels whose error is above T px of the full size, or that have no value", "%",
         pattern=r"totbad [\d.]+( \([\d.]+\))?"),
    Term("invalid", "share of pixels without a value", "%"),
    Term("out T", "KITTI: share of pixels of the interpolated map whose error is above T px", "%",
         pattern=r"out [\d.]+"),
    Term("D1", "KITTI 2015: share of pixels whose error is above 3 px and at least 5 % of the true disparity", "%",
         pattern=r"D1( 3)?"),
    Term("est METRIC", "KITTI: the metric over the pixels with a value in the map itself", pattern="est .*"),
    Term("coverage", "share of pixels with known ground truth that have a value", "%"),
    Term("avgerr", "mean absolute error", "px"),
    Term("rms", "root of the mean squared error", "px"),
    Term("A50, A90, A95, A99", "error that this percentage of the estimated pixels does not exceed", "px",
         pattern=r"A\d\d"),
    Term("MAE", "depth: mean absolute error; registration: mean |expected - true error|", "mm"),
    Term("MAE px", "mean absolute error in disparities of the sensor", "px"),
    Term("RMSE", "root of the mean squared error", "mm"),
    Term("REL", "mean of |error| / true depth"),
    Term("delta T", "share of pixels where the larger of z / z_true and z_true / z is below T", "%",
         pattern=r"delta [\d.]+"),
    Term("Spearman", "rank correlation of expected and true errors, -1 to 1"),
    Term("Pearson", "linear correlation of expected and true errors, -1 to 1"),
    Term("AUC T", "share of pairs of points, one with a true error above T mm and one below, in the correct order",
         pattern=r"AUC [\d.]+"),
    Term("accuracy", "share of points with expected and true error in one class: below 3, 3 to 6, from 6 mm", "%"),
    Term("expected", "mean expected error of the points", "mm"),
    Term("TRE", "target registration error: mean true error of the points, the same for every method", "mm"),
    Term("TRE std", "standard deviation of the true errors", "mm"),
    Term("TRE30", "mean of the worst 30 % of the true errors", "mm"),
)  # fmt: skip
"""Metrics; a heading is a metric with its threshold."""

REGIONS = (
    Term("all", "headline over all pixels with known ground truth"),
    Term("nonocc", "headline over the pixels that both views see", also=("noc",)),
    Term("occ", "KITTI: headline over all pixels; depth: over pixels occluded in the other view", also=("occluded",)),
    Term("disc", "headline near discontinuities of depth"),
    Term("noc_bg, noc_fg, occ_bg, occ_fg", "headline over the background, or the objects, of that region",
         pattern="(noc|occ)_[bf]g"),
    Term("class_0, class_1, class_2, class_3", "Booster: headline over materials of that class",
         pattern="class_[0-3]"),
    Term("gap", "headline where the sensor measured nothing"),
    Term("specular", "headline where the sensor measured nothing because of a reflection"),
    Term("mismatch", "headline where the sensor's value is incorrect"),
    Term("measured", "headline where the sensor measured"),
    Term("object", "headline over the objects"),
    Term("transparent", "headline over transparent objects"),
    Term("landmarks", "headline over the landmarks"),
    Term("voxels", "headline over the voxels whose true error is known"),
)  # fmt: skip
"""Regions: the heading of a column with the headline in this region."""

TABLES = (
    Term("run", "name of a run: that of its folder, or NAME of NAME=DIR"),
    Term("scene", "name of a scene, or the mean over several; *: no map, all pixels count as incorrect"),
    Term("scenes", "number of scenes of the row, and how many of them have no map"),
    Term("data set", "folder of the scenes"),
    Term("protocol", "rules of the scores of a scene"),
    Term("metric", "name of a metric: the first columns of this list"),
    Term("mask", "region of the pixels: nonocc, all, disc and others", also=("region",)),
    Term("figure", "headline over the scenes, in the regions of the column 'regions': a mean, or pooled"),
    Term("regions", "regions of the figure"),
    Term("mean of N", "mean over N scenes; in the headline table, mean over N figures, one per scene and region; "
         "pooled: computed from the pixels or points of all N scenes together",
           also=("mean", "pooled"), pattern=r"(mean|pooled) of \d+( common)?"),
    Term("REGION (N of M)", "headline in a region for which N of M scenes have ground truth",
         pattern=r".* \(\d+ of \d+\)"),
    Term("avg rank", "mean rank of the run over scenes and regions, 1 is best; equal values share a rank"),
    Term("density REGION %", "share of the region's pixels that have a value", "%", pattern=r"density .* %"),
    Term("seconds", "mean computing time of a scene, from the run's report", "s"),
    Term("s/MP", "computing time for a million pixels", "s"),
    Term("s/GD", "computing time for 10^9 pixels x disparities searched", "s"),
    Term("wins", "scenes on which the run's figure is better than the best run's"),
    Term("losses", "scenes on which the run's figure is worse than the best run's"),
    Term("p (Holm)", "p value of the Wilcoxon test against the best run, corrected for the number of tests"),
    Term("verdict", "result of the test: not significant, worse, better in most scenes, too few scenes"),
    Term("confidence", "name of a confidence measure, from the file confidence_NAME"),
    Term("of", "quantity of the sparsification curve: bad, the share of incorrect pixels, or error, the mean error"),
    Term("AUC", "area under the sparsification curve over all shares of pixels, the most certain first"),
    Term("optimal", "the smallest possible area, for an order by the error itself"),
    Term("random", "the area for pixels in random order, which is the mean error"),
    Term("AUC/optimal", "the area / the optimal area, 1 is best; in means: mean area / mean optimal area"),
    Term("AUSE", "area under the curve - the optimal area, 0 is best; registration: of the true error, mm"),
    Term("AURG", "random area - area under the curve, larger is better; registration: of the true error, mm"),
    Term("AUC 5-100", "the area by trapezoids over shares of 5 to 100 %, as in papers on learned confidence"),
    Term("optimal 5-100", "the smallest possible area over shares of 5 to 100 %"),
    Term("ECE", "expected calibration error, 0 is best: mean |confidence - share correct| of 20 bins of confidence"),
    Term("maps", "number of maps of the row"),
    Term("level %", "level of the run's bounds: the share of pixels whose error should be within the bound", "%"),
    Term("coverage %", "share of pixels with ground truth and a value whose error is within the map's bound", "%"),
    Term("worst map %", "the smallest coverage of a map", "%"),
    Term("covering maps %", "share of maps whose coverage is at least the level minus 10 points", "%"),
    Term("finite %", "share of values with a finite bound", "%"),
    Term("median", "median bound"),
    Term("mean/constant", "mean finite bound / the smallest constant bound with the same coverage; smaller is sharper"),
    Term("bad of N %", "share of incorrect pixels among the N % of the pixels with the smallest bounds", "%",
         pattern=r"bad of \d+ %"),
    Term("said measured, said filled, said occluded, said kept, said corrected",
           "pixels with this status in the map's status.png", pattern="said (measured|filled|occluded|kept|corrected)"),
    Term("precision", "share of the pixels that status.png marks as hidden in the right view that are hidden", "%"),
    Term("recall", "share of the pixels hidden in the right view that status.png marks as hidden", "%"),
    Term("F1", "harmonic mean of precision and recall of the hidden pixels", "%"),
    Term("said hidden %", "share of the pixels that status.png marks as hidden", "%"),
    Term("truly hidden %", "share of the pixels that are hidden in the right view in the ground truth", "%"),
    Term("reason", "why there is no map, or no score"),
    Term("true class", "class of the true error (rows); the columns are classes of the expected error"),
    Term("< 3 mm, 3-6 mm, >= 6 mm", "number of points whose expected error is in that class", pattern=".*[<>-].* mm"),
    Term("mean expected error", "mean expected error of the points of a bin", "mm"),
    Term("mean true error", "mean true error of the points of a bin", "mm"),
    Term("points", "number of points"),
)  # fmt: skip
"""Columns of the printed tables, of ``report.md``, LaTeX and the page, except metrics, regions and names of scenes."""

SCORES = (
    Term("run", "name of the run"),
    Term("data_set", "folder of the scenes"),
    Term("scene", "name of the scene; *mean: over all scenes, *common mean: over scenes with maps of all runs"),
    Term("protocol", "rules of the scores"),
    Term("metric", "name of the metric; failed: no map; AREA:CONFIDENCE:KIND: area of a curve, or ece; hidden NAME"),
    Term(
        "threshold",
        "threshold of the metric, in the protocol's unit; bound coverage: level, bad of surest: share, both in %",
    ),
    Term("mask", "region of the pixels"),
    Term("value", "the number"),
    Term("unit", "unit of the value"),
    Term("wrong", "number of incorrect pixels, if the metric counts them"),
    Term("pixels", "number of pixels, points or voxels of the value"),
    Term("density", "share of the region's pixels that have a value", "%"),
    Term("convention", "treatment of pixels without a value"),
    Term("map", "file of the map in the run folder"),
    Term("note", "remark on the number"),
)
"""Columns of ``scores.csv``."""

POINTS = (
    Term(
        "x, y, z", "position of a landmark in the world coordinates of the volume (right-handed)", "mm", pattern="[xyz]"
    ),
    Term("expected_error", "expected error at the point", "mm"),
    Term("true_error", "true error at the point", "mm"),
    Term("confidence", "confidence at the point, larger is more certain"),
    Term("shift_x, shift_y, shift_z", "displacement of the best match at the point", "mm", pattern="shift_[xyz]"),
)
"""Columns of ``points/RUN/SCENE.csv``, and of ``points.csv`` of a registration run."""

SWEEP = (
    Term("KEY", "value of a key that was varied", pattern=r"[a-z_0-9]+(\.[a-z_0-9]+)+"),
    Term("key", "key that was varied"),
    Term("value", "its value"),
    Term("runs", "number of runs with that value"),
    Term("mean METRIC", "mean figure of these runs", pattern="mean .*"),
    Term("best", "best figure of these runs"),
    Term("spread of means", "largest difference of the means of a key's values"),
    Term("% of variance", "share of the figures' variance that the key explains alone", "%"),
    Term("data_set", "folder of the scenes"),
    Term("own_values", "whether the run has the config's own values"),
    Term("missing", "number of scenes without a map"),
)
"""Further columns of the tables of ``sweep``."""


def heading_help(heading: str) -> str:
    """Return unit and explanation of a column of an evaluation's tables; empty if it is the name of a scene."""
    plain = re.sub(r" \(\d+ of \d+\)$", "", heading)  # a number of scenes; or a unit after a comma
    names = dict.fromkeys((heading, plain, plain.rpartition(", ")[0] or plain))
    terms = (*TABLES, *METRICS, *REGIONS)
    term = next((term for name in names for term in terms if term.fits(name)), None)
    return "" if term is None else term.about + (f", {term.unit}" if term.unit else "")
