"""Meaning of the columns of an evaluation: scores by metric and region, and the other columns of every table."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class ColumnHelp:
    """The explanation of a column."""

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


Column = ColumnHelp  # in the rows below

METRICS = (
    Column("bad T", "share of pixels whose error is above T px; whether missing ones count is the protocol's rule", "%",
           pattern=r"bad [\d.]+( \([\d.]+\)| px)?"),
    Column("totbad T", "share of pixels whose error is above T px of the full size, or that have no value", "%",
           pattern=r"totbad [\d.]+( \([\d.]+\))?"),
    Column("invalid", "share of pixels without a value", "%"),
    Column("out T", "KITTI: share of pixels whose error is above T px, of the interpolated map", "%",
           pattern=r"out [\d.]+"),
    Column("D1", "KITTI 2015: share of pixels whose error is above 3 px and at least 5 % of the true disparity", "%",
           pattern=r"D1( 3)?"),
    Column("est METRIC", "KITTI: the metric over the pixels that the map itself has a value for", pattern="est .*"),
    Column("coverage", "share of the pixels with known truth that have a value", "%"),
    Column("avgerr", "mean absolute error", "px"),
    Column("rms", "root of the mean squared error", "px"),
    Column("A50, A90, A95, A99", "error that this percentage of the estimated pixels does not exceed", "px",
           pattern=r"A\d\d"),
    Column("MAE", "depth: mean absolute error; registration: mean |expected - true error|", "mm"),
    Column("MAE px", "mean absolute error as a disparity of the sensor", "px"),
    Column("RMSE", "root of the mean squared error", "mm"),
    Column("REL", "mean of |error| / true depth"),
    Column("delta T", "share of pixels where the larger of z / z_true and z_true / z is below T", "%",
           pattern=r"delta [\d.]+"),
    Column("Spearman", "rank correlation of expected and true errors, -1 to 1"),
    Column("Pearson", "linear correlation of expected and true errors, -1 to 1"),
    Column("AUC T", "share of the pairs of points, one with a true error above T mm and one below, in the right order",
           pattern=r"AUC [\d.]+"),
    Column("accuracy", "share of points whose expected error is in the true class: below 3, 3 to 6, from 6 mm", "%"),
    Column("expected", "mean expected error of the points", "mm"),
    Column("TRE", "target registration error: mean true error of the points, the same for every method", "mm"),
    Column("TRE std", "standard deviation of the true errors", "mm"),
    Column("TRE30", "mean of the worst 30 % of the true errors", "mm"),
)  # fmt: skip
"""Metrics; a heading is a metric with its threshold."""

REGIONS = (
    Column("all", "headline over all pixels with known truth"),
    Column("nonocc", "headline over the pixels that both views see", also=("noc",)),
    Column("occ", "KITTI: headline over all pixels; depth: over those occluded in the other view", also=("occluded",)),
    Column("disc", "headline near discontinuities of depth"),
    Column("noc_bg, noc_fg, occ_bg, occ_fg", "headline over the background, or the objects, of that region",
           pattern="(noc|occ)_[bf]g"),
    Column("class_0, class_1, class_2, class_3", "Booster: headline over materials of that class",
           pattern="class_[0-3]"),
    Column("gap", "headline where the sensor measured nothing"),
    Column("specular", "headline where a reflection keeps the sensor from measuring"),
    Column("mismatch", "headline where the sensor's value is wrong"),
    Column("measured", "headline where the sensor measured"),
    Column("object", "headline over the objects"),
    Column("transparent", "headline over transparent objects"),
    Column("landmarks", "headline over the landmarks"),
    Column("voxels", "headline over the voxels whose true error is known"),
)  # fmt: skip
"""Regions: as a heading of a table, its headline there."""

TABLES = (
    Column("run", "name of a run: its folder's, or NAME of NAME=DIR"),
    Column("scene", "name of a scene, or the mean over several; *: no map, counted as wholly wrong"),
    Column("scenes", "number of scenes that the row is over, and how many of them have no map"),
    Column("data set", "folder of the scenes"),
    Column("protocol", "rules by which a scene is scored"),
    Column("metric", "name of a metric: the first columns of this list"),
    Column("mask", "region of pixels that the number is over: nonocc, all, disc and the like", also=("region",)),
    Column("figure", "mean of the headline over the scenes, in the regions of the column 'mean of'"),
    Column("mean of", "regions that the figure is over"),
    Column("mean of N", "mean over N scenes; of the headline table, over N figures: each scene's in each region",
           also=("mean", "pooled"), pattern=r"(mean|pooled) of \d+( common)?"),
    Column("REGION (N of M)", "headline in a region where N of M scenes have truth", pattern=r".* \(\d+ of \d+\)"),
    Column("avg rank", "mean rank of the run over scenes and regions, 1 the best; equal values share one"),
    Column("density REGION %", "share of the region's pixels that have a value", "%", pattern=r"density .* %"),
    Column("seconds", "mean computing time of a scene, by the run's own report", "s"),
    Column("s/MP", "computing time for a million pixels", "s"),
    Column("s/GD", "computing time for 10^9 pixels x disparities searched", "s"),
    Column("wins", "scenes on which the run's figure is better than the best run's"),
    Column("losses", "scenes on which the run's figure is worse than the best run's"),
    Column("p (Holm)", "p value of the Wilcoxon test against the best run, corrected for the number of tests"),
    Column("verdict", "result of the test: not significant, worse, better in most scenes, or that scenes are too few"),
    Column("confidence", "name of a confidence measure: of the file confidence_NAME"),
    Column("of", "quantity of the sparsification curve: bad, the share of wrong pixels, or error, the mean error"),
    Column("AUC", "area under the sparsification curve over all shares of pixels, the surest first"),
    Column("optimal", "the area for an order by the error itself, the smallest possible"),
    Column("random", "the area for pixels in random order: their mean"),
    Column("AUC/optimal", "the area / the optimal one, 1 the best"),
    Column("AUSE", "area under the curve - the optimal one, 0 the best; registration: of the true error, mm"),
    Column("AURG", "random area - area under the curve, larger is better; registration: of the true error, mm"),
    Column("AUC 5-100", "the area by trapezoids over shares of 5 to 100 %, as in the literature of learned confidence"),
    Column("optimal 5-100", "the smallest possible area over shares of 5 to 100 %"),
    Column("ECE", "expected calibration error, 0 the best: mean |confidence - share right| of 20 bins of confidence"),
    Column("maps", "number of maps that the row is over"),
    Column("level %", "nominal level of the run's bounds: promised share of pixels whose error is within it", "%"),
    Column("coverage %", "share of the pixels with truth and value whose error is within the map's bound", "%"),
    Column("worst map %", "the smallest coverage of a map", "%"),
    Column("covering maps %", "share of the maps whose coverage is at most 10 points below the level", "%"),
    Column("finite %", "share of the values that have a bound below infinity", "%"),
    Column("median", "median bound"),
    Column("mean/constant", "mean finite bound / the smallest constant one with the same coverage; smaller is sharper"),
    Column("bad of N %", "share of wrong pixels among the N % of the pixels with the smallest bounds", "%",
           pattern=r"bad of \d+ %"),
    Column("said measured, said filled, said occluded, said kept, said corrected",
           "pixels that the map's own status.png calls so", pattern="said (measured|filled|occluded|kept|corrected)"),
    Column("precision", "of the pixels that status.png calls hidden in the right view, the share that are", "%"),
    Column("recall", "of the pixels that are hidden in the right view, the share that status.png calls so", "%"),
    Column("F1", "harmonic mean of precision and recall of the hidden pixels", "%"),
    Column("said hidden %", "share of the pixels that status.png marks as hidden", "%"),
    Column("truly hidden %", "share of the pixels that are hidden in the right view by the truth", "%"),
    Column("reason", "why there is no map, or no score"),
    Column("true class", "class of the true error: rows; the columns are the classes of the expected one"),
    Column("< 3 mm, 3-6 mm, >= 6 mm", "number of points whose expected error is in that class", pattern=".*[<>-].* mm"),
    Column("mean expected error", "mean expected error of the points of a bin", "mm"),
    Column("mean true error", "mean true error of the points of a bin", "mm"),
    Column("points", "number of points"),
)  # fmt: skip
"""Columns of the printed tables, of ``report.md``, LaTeX and the page, except metrics, regions and names of scenes."""

SCORES = (
    Column("run", "name of the run"),
    Column("data_set", "folder of the scenes"),
    Column("scene", "name of the scene; *mean: over all scenes, *common mean: over scenes with maps of all runs"),
    Column("protocol", "rules by which it was scored"),
    Column("metric", "name of the metric; failed: no map; AREA:CONFIDENCE:KIND: area of a curve, or ece; hidden NAME"),
    Column("threshold", "of the metric, in the protocol's unit; bound coverage: level, bad of surest: share, both %"),
    Column("mask", "region of pixels that the number is over"),
    Column("value", "the number"),
    Column("unit", "unit of the value"),
    Column("wrong", "number of wrong pixels, where the metric counts them"),
    Column("pixels", "number of pixels, points or voxels that the value is taken over"),
    Column("density", "share of the region's pixels that have a value", "%"),
    Column("convention", "how pixels without a value are counted"),
    Column("map", "file of the map in the run folder"),
    Column("note", "what a reader must know about the number"),
)
"""Columns of ``scores.csv``."""

POINTS = (
    Column("x, y, z", "place of a landmark, right-handed world coordinates of the volume", "mm", pattern="[xyz]"),
    Column("expected_error", "expected error at the point", "mm"),
    Column("true_error", "true error at the point", "mm"),
    Column("confidence", "confidence at the point, larger is surer"),
    Column("shift_x, shift_y, shift_z", "displacement of the best match at the point", "mm", pattern="shift_[xyz]"),
)
"""Columns of ``points/RUN/SCENE.csv``, and of ``points.csv`` of a registration run."""

SWEEP = (
    Column("KEY", "value of a key that was varied", pattern=r"[a-z_0-9]+(\.[a-z_0-9]+)+"),
    Column("key", "key that was varied"),
    Column("value", "its value"),
    Column("runs", "number of runs with that value"),
    Column("mean METRIC", "mean figure of these runs", pattern="mean .*"),
    Column("best", "best figure of these runs"),
    Column("spread of means", "largest difference of the means of a key's values"),
    Column("% of variance", "share of the figures' variance that the key explains alone", "%"),
    Column("data_set", "folder of the scenes"),
    Column("own_values", "whether the run has the config's own values"),
    Column("missing", "number of scenes without a map"),
)
"""Further columns of the tables of ``sweep``."""


def heading_help(heading: str) -> str:
    """Return unit and explanation of a column of an evaluation's tables; empty where it is the name of a scene."""
    plain = re.sub(r" \(\d+ of \d+\)$", "", heading)  # a number of scenes; or a unit after a comma
    names = dict.fromkeys((heading, plain, plain.rpartition(", ")[0] or plain))
    columns = (*TABLES, *METRICS, *REGIONS)
    found = next((column for name in names for column in columns if column.fits(name)), None)
    return "" if found is None else found.about + (f", {found.unit}" if found.unit else "")
