"""Wide tables of an evaluation, for papers and for the page.

They have a row for every run, a column for every scene or metric, and ranked numbers.
"""

from __future__ import annotations

import math

from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.scores import Key
from depthcli.evaluation.statistics import mean_of_known
from depthcli.evaluation.tables import cell_of, mean_rows, named, short


def wide_tables(report: EvaluationReport) -> list[Table]:
    """Return the wide tables: of every section the headline by scene, then the means of all metrics, by region."""
    made = []
    for section in report.sections:
        scenes = [wide_by_scene(section, (section.protocol.headline, region)) for region in section.regions]
        made += named(report, section, scenes + [wide_by_metric(section, region) for region in section.regions])
    return made


Column = tuple[str, list[Number], bool | None, str]
"""Heading, number of every run, whether larger is better (None: not ranked), and the scene it speaks of, or empty."""


def wide_by_scene(section: Section, key: Key) -> Table:
    """Return one metric in one region: a column for every scene, then the means and, where they are known, times."""
    metric, region = key
    columns: list[Column] = []
    for scene in section.scenes:
        results = [next(r for r in section.results_of(run) if r.scene == scene) for run in section.runs]
        if any(key in r.by_key for r in results):
            cells = [cell_of(section, r.by_key.get(key), "*" * bool(r.error)) for r in results]
            columns.append((short(scene), cells, metric.larger_is_better, scene))
    if len(section.scenes) > 1:
        heading = section.protocol.presentation.mean_heading
        columns.append(_means(section, key, f"{heading} of {len(section.scenes_with(region))}"))
        if section.common and section.incomplete:
            n_common = len(section.scenes_with(region, common=True))
            columns.append(_means(section, key, f"{heading} of {n_common} common", common=True))
        if metric == section.protocol.headline and len(section.runs) > 1:
            ranks = [Number(rank, 1) for rank in section.average_rank([key]).values()]
            columns.append(("avg rank", ranks, False, ""))
    return _wide(section, f"{section.data_set}: {metric.heading_with_unit}, {region}", columns, f"scenes-{region}")


def wide_by_metric(section: Section, region: str) -> Table:
    """Return the means over the scenes of every metric in one region, a column for each."""
    columns = [_means(section, key, key[0].heading) for key in section.keys if key[1] == region]
    many = len(section.scenes_with(region))
    over = f"means over {many} scenes" if many > 1 else ", ".join(map(short, section.scenes_with(region)))
    return _wide(section, f"{section.data_set}: {over}, {region}", columns, f"metrics-{region}")


def _means(section: Section, key: Key, heading: str, common: bool = False) -> Column:
    cells = [
        cell_of(section, section.mean(run, key, each), mark) for run, each, mark in mean_rows(section) if each == common
    ]
    return heading, cells, key[0].larger_is_better, ""


def _wide(section: Section, title: str, columns: list[Column], name: str) -> Table:
    """Columns as a table, with the mean seconds of a scene, a megapixel, and 10^9 pixels x disparities beside."""
    runs = [section.results_of(run) for run in section.runs]
    times = {
        "seconds": [mean_of_known(r.seconds for r in results) for results in runs],
        "s/MP": [mean_of_known(1e6 * r.seconds / r.size for r in results if r.size) for results in runs],
        "s/GD": [
            mean_of_known(1e9 * r.seconds / (r.size * r.n_disparities) for r in results if r.size and r.n_disparities)
            for results in runs
        ],
    }
    known = {heading: values for heading, values in times.items() if not all(map(math.isnan, values))}
    columns = columns + [(heading, [Number(v) for v in values], False, "") for heading, values in known.items()]
    rows = tuple((run, *(cells[i] for _, cells, _, _ in columns)) for i, run in enumerate(section.runs))
    note = "*: no map, counted as wholly wrong; means over scenes that all runs have beside" * section.incomplete
    return Table(
        title,
        ("run", *(heading for heading, *_ in columns)),
        rows,
        note,
        (None, *(larger for _, _, larger, _ in columns)),
        ("", *(scene for *_, scene in columns)),
        name,
    )
