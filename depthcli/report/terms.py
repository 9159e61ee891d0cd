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
        """Return whether a column is meant, by its heading without a unit behind a comma."""
        return heading in (self.name, *self.also) or bool(self.pattern and re.fullmatch(self.pattern, heading))


METRICS = (
    Term("bad T", "share of pixels whose error is above T px; whether missing ones count is the protocol's rule", "%",
         pattern=r"bad [\d.]+( \([\d.]+\)| px)?"),
    Term("totbad T", "share of pixels whose error is above T px of the full size, or that have no value", "%",
         pattern=r"totbad [\d.]+( \([\d.]+\))?"),
    Term("invalid", "share of pixels without a value", "%"),
    Term("out T", "KITTI: share of pixels whose error is above T px, of the interpolated map", "%",
         pattern=r"out [\d.]+"),
    Term("D1", "KITTI 2015: share of pixels whose error is above 3 px and at least 5 % of the true disparity", "%",
         pattern=r"D1( 3)?"),
    Term("est METRIC", "KITTI: the metric over the pixels that the map itself has a value for", pattern="est .*"),
    Term("coverage", "share of the pixels with known truth that have a value", "%"),
    Term("avgerr", "mean absolute error", "px"),
    Term("rms", "root of the mean squared error", "px"),
    Term("A50, A90, A95, A99", "error that this percentage of the estimated pixels does not exceed", "px",
         pattern=r"A\d\d"),
    Term("MAE", "depth: mean absolute error; registration: mean |expected - true error|", "mm"),
    Term("MAE px", "mean absolute error as a disparity of the sensor", "px"),
    Term("RMSE", "root of the mean squared error", "mm"),
    Term("REL", "mean of |error| / true depth"),
    Term("delta T", "share of pixels where the larger of z / z_true and z_true / z is below T", "%",
         pattern=r"delta [\d.]+"),
    Term("Spearman", "rank correlation of expected and true errors, -1 to 1"),
    Term("Pearson", "linear correlation of expected and true errors, -1 to 1"),
    Term("AUC T", "share of the pairs of points, one with a true error above T mm and one below, in the right order",
         pattern=r"AUC [\d.]+"),
    Term("accuracy", "share of points whose expected error is in the true class: below 3, 3 to 6, from 6 mm", "%"),
    Term("expected", "mean expected error of the points", "mm"),
    Term("TRE", "target registration error: mean true error of the points, the same for every method", "mm"),
    Term("TRE std", "standard deviation of the true errors", "mm"),
    Term("TRE30", "mean of the worst 30 % of the true errors", "mm"),
)  # fmt: skip
"""Metrics; a heading is a metric with its threshold."""

REGIONS = (
    Term("all", "headline over all pixels with known truth"),
    Term("nonocc", "headline over the pixels that both views see", also=("noc",)),
    Term("occ", "KITTI: headline over all pixels; depth: over those occluded in the other view", also=("occluded",)),
    Term("disc", "headline near discontinuities of depth"),
    Term("noc_bg, noc_fg, occ_bg, occ_fg", "headline over the background, or the objects, of that region",
         pattern="(noc|occ)_[bf]g"),
    Term("class_0, class_1, class_2, class_3", "Booster: headline over materials of that class",
         pattern="class_[0-3]"),
    Term("gap", "headline where the sensor measured nothing"),
    Term("specular", "headline where a reflection keeps the sensor from measuring"),
    Term("mismatch", "headline where the sensor's value is wrong"),
    Term("measured", "headline where the sensor measured"),
    Term("object", "headline over the objects"),
    Term("transparent", "headline over transparent objects"),
    Term("landmarks", "headline over the landmarks"),
    Term("voxels", "headline over the voxels whose true error is known"),
)  # fmt: skip
"""Regions: as a heading of a table, its headline there."""

TABLES = (
    Term("run", "name of a run: its folder's, or NAME of NAME=DIR"),
    Term("scene", "name of a scene, or the mean over several; *: no map, counted as wholly wrong"),
    Term("scenes", "number of scenes that the row is over, and how many of them have no map"),
    Term("data set", "folder of the scenes"),
    Term("protocol", "rules by which a scene is scored"),
    Term("metric", "name of a metric: the first columns of this list"),
    Term("mask", "region of pixels that the number is over: nonocc, all, disc and the like", also=("region",)),
    Term("figure", "headline over the scenes, in the regions of the column 'regions': a mean, or pooled"),
    Term("regions", "regions that the figure is over"),
    Term("mean of N", "mean over N scenes; of the headline table, over N figures: each scene's in each region; pooled: "
         "computed from the pixels or points of all N scenes together, which is no mean of the scenes' numbers",
           also=("mean", "pooled"), pattern=r"(mean|pooled) of \d+( common)?"),
    Term("REGION (N of M)", "headline in a region where N of M scenes have truth", pattern=r".* \(\d+ of \d+\)"),
    Term("avg rank", "mean rank of the run over scenes and regions, 1 the best; equal values share one"),
    Term("density REGION %", "share of the region's pixels that have a value", "%", pattern=r"density .* %"),
    Term("seconds", "mean computing time of a scene, by the run's own report", "s"),
    Term("s/MP", "computing time for a million pixels", "s"),
    Term("s/GD", "computing time for 10^9 pixels x disparities searched", "s"),
    Term("wins", "scenes on which the run's figure is better than the best run's"),
    Term("losses", "scenes on which the run's figure is worse than the best run's"),
    Term("p (Holm)", "p value of the Wilcoxon test against the best run, corrected for the number of tests"),
    Term("verdict", "result of the test: not significant, worse, better in most scenes, or that scenes are too few"),
    Term("confidence", "name of a confidence measure: of the file confidence_NAME"),
    Term("of", "quantity of the sparsification curve: bad, the share of wrong pixels, or error, the mean error"),
    Term("AUC", "area under the sparsification curve over all shares of pixels, the surest first"),
    Term("optimal", "the area for an order by the error itself, the smallest possible"),
    Term("random", "the area for pixels in random order: their mean"),
    Term("AUC/optimal", "the area / the optimal one, 1 the best; of a mean: mean area / mean optimal one"),
    Term("AUSE", "area under the curve - the optimal one, 0 the best; registration: of the true error, mm"),
    Term("AURG", "random area - area under the curve, larger is better; registration: of the true error, mm"),
    Term("AUC 5-100", "the area by trapezoids over shares of 5 to 100 %, as in the literature of learned confidence"),
    Term("optimal 5-100", "the smallest possible area over shares of 5 to 100 %"),
    Term("ECE", "expected calibration error, 0 the best: mean |confidence - share right| of 20 bins of confidence"),
    Term("maps", "number of maps that the row is over"),
    Term("level %", "nominal level of the run's bounds: promised share of pixels whose error is within it", "%"),
    Term("coverage %", "share of the pixels with truth and value whose error is within the map's bound", "%"),
    Term("worst map %", "the smallest coverage of a map", "%"),
    Term("covering maps %", "share of the maps whose coverage is at most 10 points below the level", "%"),
    Term("finite %", "share of the values that have a bound below infinity", "%"),
    Term("median", "median bound"),
    Term("mean/constant", "mean finite bound / the smallest constant one with the same coverage; smaller is sharper"),
    Term("bad of N %", "share of wrong pixels among the N % of the pixels with the smallest bounds", "%",
         pattern=r"bad of \d+ %"),
    Term("said measured, said filled, said occluded, said kept, said corrected",
           "pixels that the map's own status.png calls so", pattern="said (measured|filled|occluded|kept|corrected)"),
    Term("precision", "of the pixels that status.png calls hidden in the right view, the share that are", "%"),
    Term("recall", "of the pixels that are hidden in the right view, the share that status.png calls so", "%"),
    Term("F1", "harmonic mean of precision and recall of the hidden pixels", "%"),
    Term("said hidden %", "share of the pixels that status.png marks as hidden", "%"),
    Term("truly hidden %", "share of the pixels that are hidden in the right view by the truth", "%"),
    Term("reason", "why there is no map, or no score"),
    Term("true class", "class of the true error: rows; the columns are the classes of the expected one"),
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
    Term("protocol", "rules by which it was scored"),
    Term("metric", "name of the metric; failed: no map; AREA:CONFIDENCE:KIND: area of a curve, or ece; hidden NAME"),
    Term("threshold", "of the metric, in the protocol's unit; bound coverage: level, bad of surest: share, both %"),
    Term("mask", "region of pixels that the number is over"),
    Term("value", "the number"),
    Term("unit", "unit of the value"),
    Term("wrong", "number of wrong pixels, where the metric counts them"),
    Term("pixels", "number of pixels, points or voxels that the value is taken over"),
    Term("density", "share of the region's pixels that have a value", "%"),
    Term("convention", "how pixels without a value are counted"),
    Term("map", "file of the map in the run folder"),
    Term("note", "what a reader must know about the number"),
)
"""Columns of ``scores.csv``."""

POINTS = (
    Term("x, y, z", "place of a landmark, right-handed world coordinates of the volume", "mm", pattern="[xyz]"),
    Term("expected_error", "expected error at the point", "mm"),
    Term("true_error", "true error at the point", "mm"),
    Term("confidence", "confidence at the point, larger is surer"),
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
    """Return unit and explanation of a column of an evaluation's tables; empty where it is the name of a scene."""
    plain = re.sub(r" \(\d+ of \d+\)$", "", heading)  # a number of scenes; or a unit after a comma
    names = dict.fromkeys((heading, plain, plain.rpartition(", ")[0] or plain))
    terms = (*TABLES, *METRICS, *REGIONS)
    term = next((term for name in names for term in terms if term.fits(name)), None)
    return "" if term is None else term.about + (f", {term.unit}" if term.unit else "")
