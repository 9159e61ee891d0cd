"""Plots as SVG. matplotlib is imported only when a plot is drawn; the same numbers give the same bytes."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from depthcli.evaluation.bounds import COVERAGE
from depthcli.evaluation.comparison import Section
from depthcli.evaluation.curves import PERCENTAGES, ConfidenceCurve, Reliability, Sparsification
from depthcli.evaluation.scores import MEAN, Score
from depthcli.evaluation.statistics import mean_of_known

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe & Ito's palette without its yellow, which is too pale for a line.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#000000")
_MARKERS = "osD^vPX*"
_BOUND = "#777777"
_MAX_CURVES = 6  # of a plot, without its bounds; the tables have all
_SHARE_AXIS = "most confident pixels, %"
_SETTINGS: dict[str, Any] = {"svg.fonttype": "none", "svg.hashsalt": "depthcli", "font.size": 10}
_SETTINGS |= {"axes.spines.top": False, "axes.spines.right": False}


class Plot(NamedTuple):
    """A plot of one data set."""

    name: str  # of its files
    svg: str  # text of an SVG file
    rows: Sequence[Mapping[str, Any]] = ()  # numbers of its curves; empty: it has none


def plots(section: Section) -> dict[str, Plot]:
    """Return caption -> plot, of all plots that the section has numbers for."""
    by_caption = {}
    metric, word = section.protocol.headline.heading_with_unit, section.protocol.presentation.mean_heading
    what = f"{metric}, {section.regions[0]}"
    if len(section.scenes) > 2:
        caption = f"Spread over the scenes ({what}): box: middle half; line: median; dots: scenes"
        by_caption[caption] = Plot("spread", _boxes(section, what))
    if lines := {run: scores for run in section.ranking.runs if (scores := section.threshold_curve(run))}:
        caption = f"Against the threshold, {word} of all scenes{_best(len(lines))}; dots: thresholds of the tables"
        rows = [
            {"run": run, s.metric.name: s.value, "threshold": s.metric.threshold, "mask": s.region, "statistic": word}
            for run, scores in lines.items()
            for s in scores
        ]
        lines = dict([*lines.items()][:_MAX_CURVES])
        shown = {run: lines[run] for run in section.runs if run in lines}
        by_caption[caption] = Plot("threshold", _by_threshold(section, shown), rows)
    if any(not math.isnan(r.seconds) for r in section.results):
        of_all = f"{metric}, {' + '.join(section.figure_regions)}"
        by_caption[f"Mean time of a scene against {of_all}, {word} of all scenes"] = Plot(
            "times", _times(section, f"{of_all}, {word}")
        )
    if coverage := _coverage(section):
        what = f"Coverage of the bounds against their level, {section.regions[0]}: means over the maps"
        by_caption[f"{what}; dotted: as promised"] = Plot("coverage", coverage)
    return by_caption | _confidences(section)


def _boxes(section: Section, what: str) -> str:
    """Return the spread of the main region's headline over the scenes, a row for each run."""
    key = (section.protocol.headline, section.regions[0])
    values = {run: [section.score(run, scene, key).value for scene in section.scenes] for run in section.runs}
    rows = {run: known for run, row in values.items() if (known := [v for v in row if not math.isnan(v)])}
    with _figure(what, height=1.2 + 0.32 * len(rows)) as (axes, out):
        places = range(len(rows), 0, -1)
        style: dict[str, Any] = {"widths": 0.55, "showfliers": False, "medianprops": {"color": "black"}}
        axes.boxplot(list(rows.values()), positions=list(places), orientation="horizontal", **style)
        for i, (place, row) in enumerate(zip(places, rows.values(), strict=True)):
            axes.plot(row, [place] * len(row), **_dot(i, 4) | {"marker": "o"}, alpha=0.7)
        axes.set_yticks(list(places), [_plain(run) for run in rows])
        axes.set_xlim(left=0)
    return out[0]


def _by_threshold(section: Section, lines: Mapping[str, Sequence[Score]]) -> str:
    """Return lines of the protocol's rates at many thresholds; dots: thresholds of the tables."""
    some = next(iter(lines.values()))[0]
    keys = [(m, region) for m, region in section.keys if m.threshold is not None and region == some.region]
    keys = [key for key in keys if key[0] == replace(some.metric, threshold=key[0].threshold)]
    presentation = section.protocol.presentation
    y_label = f"{some.metric.name}, {some.metric.unit}, {some.region}, {presentation.mean_heading}"
    with _figure(presentation.threshold_axis, y_label, len(section.runs)) as (axes, out):
        for i, run in ((i, run) for i, run in enumerate(section.runs) if run in lines):
            points = [(s.metric.threshold, s.value) for s in lines[run] if s.metric.threshold is not None]
            _line(axes, i, run, points, marker="")
            shown = [(key[0].threshold or 0.0, section.score(run, MEAN, key).value) for key in keys]
            dots = [(x, y) for x, y in shown if points and x <= points[-1][0]]
            axes.plot([x for x, _ in dots], [y for _, y in dots], **_dot(i, 4))
        if not some.metric.larger_is_better:
            axes.set_ylim(bottom=0)
    return out[0]


def _times(section: Section, what: str) -> str:
    """Return the single figure of every run against its mean seconds a scene; ``what`` names the figure."""
    from matplotlib.ticker import LogLocator

    with _figure("seconds a scene, mean", what, len(section.runs)) as (axes, out):
        for i, run in enumerate(section.runs):
            score, seconds = section.overall(run), mean_of_known(r.seconds for r in section.results_of(run))
            if not math.isnan(score.value + seconds):
                axes.plot([seconds], [score.value], label=_plain(run), **_dot(i, 8))
        axes.set_xscale("log")
        low, high = axes.dataLim.intervalx
        if 0 < low < math.inf:  # room for two round numbers at least
            axes.set_xlim(low / 2, 2 * high)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.set_ylim(0, 1.08 * axes.dataLim.y1 if axes.dataLim.y1 > 0 else 1)
    return out[0]


def _coverage(section: Section) -> str:
    """Return the coverage of the runs' bounds against the levels that they promise; empty if all have one level."""
    key = COVERAGE, section.regions[0]
    coverages = [(run, s) for run in section.runs for s in section.bounds[run] if (s.metric.name, s.region) == key]
    lines = [Line(run, [score.metric.threshold or 0], [score.value]) for run, score in coverages]
    if len({level for line in lines for level in line.x}) < 2:
        return ""
    lines.append(Line("", (50, 100), (50, 100), bound=True))
    return line_plot(lines, "", "level, %", "coverage, %, mean of the maps", any_names=True)


def _confidences(section: Section) -> dict[str, Plot]:
    """Return caption -> plot of sparsification and reliability, a line per run and confidence over all scenes."""
    groups: dict[tuple[str, str], dict[str, list[ConfidenceCurve]]] = {}
    for r in section.results:
        for c in r.curves:
            name = f"{r.run}: {c.confidence}" if len(section.runs) > 1 else c.confidence
            groups.setdefault((c.region, c.of), {}).setdefault(name, []).append(c)
    by_caption: dict[str, Plot] = {}
    reliabilities: dict[str, Plot] = {}
    for (region, of), curves in groups.items():
        by_caption |= _sparsification(section, region, of, curves)
        reliabilities |= _reliability(region, curves)
    return by_caption | reliabilities


def _sparsification(
    section: Section, region: str, of: str, curves: Mapping[str, Sequence[ConfidenceCurve]]
) -> dict[str, Plot]:
    """Return caption -> plot of the mean sparsification of curves, name -> curve of each map."""
    errors, best = (
        {name: tuple(map(mean_of_known, zip(*(getattr(c.line, kind) for c in group), strict=True)))
         for name, group in curves.items()}
        for kind in ("errors", "best")
    )  # fmt: skip
    ordered = sorted(curves, key=lambda name: sum(errors[name]))
    drawn = [Line(name, PERCENTAGES, errors[name]) for name in ordered[:_MAX_CURVES]]
    drawn += [Line("", PERCENTAGES, line, True) for line in dict.fromkeys(best.values())]
    what = "share of incorrect pixels" if of == "bad" else "mean error"
    y_label = what if of == "bad" else f"{what}, {section.protocol.presentation.unit}"
    over = _statistic("mean", curves.values())
    caption = f"Sparsification, {region}: {what} of the most confident pixels, {over}{_best(len(curves))}"
    rows = [
        {"curve": name, "statistic": _statistic("mean", [curves[name]]), "percent of the pixels": percent,
         y_label: error}
        for name in ordered
        for percent, error in zip(PERCENTAGES, errors[name], strict=True)
    ]  # fmt: skip
    svg = line_plot(drawn, over, _SHARE_AXIS, y_label, any_names=True)
    return {f"{caption}; dotted: the best ranking": Plot(f"sparsification_{region}_{of}", svg, rows)}


def _reliability(region: str, curves: Mapping[str, Sequence[ConfidenceCurve]]) -> dict[str, Plot]:
    """Return caption -> plot of the pooled reliability of curves; empty if no confidence is a probability."""
    known = {name: [c.reliability for c in group if c.reliability] for name, group in curves.items()}
    known = {name: group for name, group in known.items() if group}
    if not known:
        return {}
    pooled = {name: Reliability.pooled(group) for name, group in known.items()}
    over, more = _statistic("pooled", known.values()), _best(len(pooled))
    pooled = dict(sorted(pooled.items(), key=lambda named: named[1].ece)[:_MAX_CURVES])
    drawn = [Line(f"{name} {one.ece:.3f}", one.confidence, one.right) for name, one in pooled.items()]
    drawn.append(Line("", (0, 1), (0, 1), bound=True))
    what = f"share of correct pixels by confidence, with the expected calibration error, {over}{more}"
    rows = [
        {"curve": name, "statistic": _statistic("pooled", [known[name]]), "confidence": confidence,
         "share of correct pixels": right}
        for name, one in pooled.items()
        for confidence, right in zip(one.confidence, one.right, strict=True)
    ]  # fmt: skip
    svg = line_plot(drawn, over, "confidence", "share of correct pixels", any_names=True)
    return {f"Reliability, {region}: {what}; dotted: as often as they say": Plot(f"reliability_{region}", svg, rows)}


def _statistic(word: str, groups: Iterable[Sequence[object]]) -> str:
    """Return ``mean of 3``, the word of the tables with the number of maps; a range if the groups differ in it."""
    sizes = [len(group) for group in groups]
    return f"{word} of {min(sizes)}" + (f" to {max(sizes)}" if max(sizes) > min(sizes) else "")


class Line(NamedTuple):
    """One line of a plot: name in the legend, points, and whether it is a bound, drawn grey and dotted."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    bound: bool = False


def line_plot(lines: Sequence[Line], title: str, x_label: str, y_label: str, any_names: bool = False) -> str:
    """Return lines with axes, grid and legend, as the text of an SVG file.

    Parameters
    ----------
    lines : NaN leaves a gap. From the ninth line on, colors are used again, with dashed lines. A line without a name
        is not in the legend
    title, x_label, y_label : plain text
    any_names : fit the margins to names of any length, which takes twice the time
    """
    with _figure(x_label, y_label, len(lines), fixed=not any_names) as (axes, out):
        for i, line in enumerate(lines):
            points = list(zip(line.x, line.y, strict=True))
            if line.bound:
                axes.plot(line.x, line.y, ":", color=_BOUND, label=_plain(line.name))
            else:
                _line(axes, i, line.name, points)
        axes.set_title(_plain(title, 70), fontsize=10, loc="left")
        axes.set_ylim(bottom=0)
    return out[0]


def curve_plot(curves: Mapping[str, Sparsification], title: str, of: str) -> str:
    """Return the sparsification curves of one region with their bounds, the best first, as the text of an SVG file."""
    ordered = sorted(curves.items(), key=lambda named: named[1].auc)
    lines = [Line(f"{name} {c.auc:.4f}", c.percentages, c.errors) for name, c in ordered[:_MAX_CURVES]]
    some = ordered[0][1]
    lines.append(Line(f"optimal {some.optimal:.4f}", some.percentages, some.best, bound=True))
    lines.append(Line(f"random {some.mean:.4f}", some.percentages, [some.mean] * len(some.percentages), bound=True))
    y_label = "error rate" if of == "bad" else "mean absolute error"
    return line_plot(lines, f"{title}{_best(len(ordered))}", _SHARE_AXIS, y_label)


def _best(n_curves: int) -> str:
    """Return words for how many of the curves are drawn; empty: all."""
    return f", the best {_MAX_CURVES} of {n_curves}" if n_curves > _MAX_CURVES else ""


@contextmanager
def _figure(
    x_label: str, y_label: str = "", lines: int = 0, height: float = 3.4, fixed: bool = False
) -> Iterator[tuple[Axes, list[str]]]:
    """Yield axes for a number of lines, and a list that receives the SVG's text; ``fixed``: with fixed margins."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    out: list[str] = []
    # A name in a script that the font lacks is still a name: the reader's browser has the font.
    with matplotlib.rc_context(_SETTINGS), warnings.catch_warnings():  # type: ignore[arg-type]
        warnings.simplefilter("ignore")
        figure = Figure(figsize=(6.2, height), layout=None if fixed else "constrained")
        if fixed:
            figure.subplots_adjust(left=0.11, right=0.68, bottom=0.15, top=0.92)
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        axes.grid(color="#e4e4e4")
        axes.set_axisbelow(True)
        axes.set_xlabel(_plain(x_label))
        axes.set_ylabel(_plain(y_label))
        yield axes, out
        if axes.get_legend_handles_labels()[0]:
            place: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)}
            axes.legend(**place, frameon=False, fontsize=9 if lines < 14 else 6)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    out.append(text.getvalue())


def _line(axes: Axes, i: int, name: str, points: Sequence[tuple[float, float]], marker: str | None = None) -> None:
    x, y = zip(*points, strict=True) if points else ((), ())
    style = _dot(i, 4) | {"linestyle": "-" if i < len(_COLORS) else "--"}
    axes.plot(x, y, **(style if marker is None else style | {"marker": marker}), lw=1.4, label=_plain(name))


def _dot(i: int, size: float) -> dict[str, Any]:
    style = {"marker": _MARKERS[i % len(_MARKERS)], "color": _COLORS[i % len(_COLORS)]}
    return {"linestyle": "", "ms": size, **style}


def _plain(text: str, max_length: int = 40) -> str:
    """Return a name of limited length that matplotlib does not read as a formula."""
    text = text if len(text) <= max_length else f"{text[: max_length - 16]}...{text[-12:]}"
    text = "".join(char if char.isprintable() else "?" for char in text).replace("$", r"\$")
    return f"\u200b{text}" if text.startswith("_") else text  # else it is left out of the legend
