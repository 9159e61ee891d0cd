"""Compare the maps of one or more runs with the ground truth, side by side.

A run is a folder that ``depthcli`` made, or a folder of maps by another program; which files are a scene's map, how it
is read and what it scores is up to the scene's protocol (``depthcli/evaluation/protocols``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.batch.command import SOME_FAILED, Command, Values
from depthcli.commands._options import LAYOUT, SCENES
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.console import Reporter
    from depthcli.data.scenes import Scene
    from depthcli.evaluation.protocols import Settings
    from depthcli.evaluation.results import EvaluationReport, Result
    from depthcli.report.page import Page

HTML = (
    Option("html", bool, "Also write report.html, to look at maps and errors in a browser.", default=False),
    Option("html_budget", str, "Size beyond which its pictures are scaled down, full ones beside it.", "SIZE",
           default="50MB"),
)  # fmt: skip
# Of a truth file that lies in no scene's folder and has no --protocol.
_PLAIN = "middlebury_v2"


class EvaluateCommand(Command):
    """``depthcli evaluate RUN... --truth DIR [--output DIR]``."""

    @property
    def arguments(self) -> tuple[Option, ...]:
        """The runs."""
        about = "Run folders, folders of others' maps, or single maps."
        return (Option("runs", Path, about, "RUN...", many=True, required=True),)

    @property
    def options(self) -> tuple[Option, ...]:
        """What to compare with, and how."""
        return (
            Option("truth", Path, "Folder of scenes with ground truth; for single maps, a file.", "DIR", required=True),
            Option("output", Path, "Folder for scores, pictures and the report; without it they are printed alone.",
                   "DIR", short="-o"),
            SCENES,
            LAYOUT,
            Option("protocol", str, "How to score, such as kitti-2015, instead of what the scenes name.", "NAME"),
            Option("scale", float, "Codes per unit of the maps' integer files.", "CODES", least=1e-6),
            Option("resolution", str, "Size of the ground truth of Middlebury v3, where it cannot be told.", "F|H|Q"),
            Option("resize", str, "Bring depth maps and their truth to one size, nearest neighbor.", "WxH"),
            Option("threshold", float, "Error above which a pixel is wrong, not the benchmark's.", "T", least=1e-6),
            Option("format", str, "Print wide tables: latex, markdown or csv; best bold, second underlined.", "FORMAT"),
            *HTML,
        )  # fmt: skip

    def run(self, values: Values, reporter: Reporter) -> int:
        """Evaluate and print the tables; the exit code."""
        from depthcli.batch.json_csv import to_json
        from depthcli.evaluation.matrix import FORMATS, written
        from depthcli.evaluation.protocols import Settings, parse_size

        resolution, resize = (values["resolution"] or "").upper() or None, parse_size(values["resize"])
        settings = Settings(values["scale"], resolution, values["threshold"], resize)
        form = values["format"]
        if form is not None and form not in FORMATS:
            raise ConfigError(f"--format: want {', '.join(FORMATS)} (got {form!r})")
        report = evaluate(
            values["runs"], values["truth"], values["output"], values["scenes"] or ["*"], values["layout"],
            values["protocol"], settings, reporter, page=new_page(self, values, values["output"]),
        )  # fmt: skip
        if values["json"]:
            reporter.data(to_json(report.to_dict()))
        elif form is not None:
            reporter.data(written(report, form))
        elif not values["quiet"]:
            reporter.data(report.text())
        if values["output"] is not None:
            reporter.info(f"report and error pictures in {values['output']}")
        return SOME_FAILED if report.failed else 0


def evaluate(
    runs: Sequence[Path | str],
    truth: Path | str,
    output: Path | str | None,
    scenes: Sequence[str] = ("*",),
    layout: str | None = None,
    protocol: str | None = None,
    settings: Settings | None = None,
    reporter: Reporter | None = None,
    kinds: Iterable[type[Scene]] | None = None,
    page: Page | None = None,
) -> EvaluationReport:
    """Evaluate runs side by side and write scores, pictures, curves and a report.

    Written to ``output``: ``scores.csv``, ``scores.json``, ``report.md``,
    ``errors/<run>/<scene>.png``, ``curves/<run>/<scene>_<region>_<kind>.svg``.

    Parameters
    ----------
    runs : folders of maps; or maps, where there is a single scene
    truth : folder of scenes with ground truth, or one file of it
    output : folder for the results; None: nothing is written
    scenes : shell patterns of scene names
    layout : layout of ``truth``; None recognizes it
    protocol : its name; None: what every scene names
    settings : what a user said about the evaluation
    reporter : told about progress, failures and suspicions
    kinds : kinds of item to evaluate; None: all, or what ``protocol`` scores
    page : is filled and written into its folder; None for none

    Raises
    ------
    InputError
        No run, no scenes with ground truth, no such protocol. A map that is missing or unreadable is no error:
        it becomes a result with its reason (``report.failed``).
    OutputError
        The results cannot be written.
    """
    from depthcli.batch.console import Reporter
    from depthcli.batch.json_csv import to_csv, to_json
    from depthcli.batch.run_folder import saved_config
    from depthcli.commands._scoring import Scoring
    from depthcli.data.formats.atomic import remove_leftovers, write_text
    from depthcli.evaluation.protocols import Settings, load
    from depthcli.evaluation.results import EvaluationReport, run_names

    reporter, settings, truth = reporter or Reporter(-1), settings or Settings(), Path(truth)
    places = [Path(run) for run in runs]
    if not places:
        raise InputError("no run to evaluate")
    if absent := [place for place in places if not (place.is_dir() or place.is_file())]:
        raise InputError(f"{absent[0]}: no such folder")
    judge = None if protocol is None else load(protocol)(settings)
    items = _scenes(truth, kinds if judge is None else [judge.kind], layout, scenes, reporter)
    if not items:
        if judge is None:
            reporter.info(f"{truth}: in no scene's folder; scored as {_PLAIN} (--protocol says otherwise)")
        items = [(judge or load(_PLAIN)(settings)).single(truth)]
    if len(items) > 1 and any(place.is_file() for place in places):
        raise InputError(f"a single map wants a single scene, {truth} has {len(items)}: give a file, or --scenes")
    target = None if output is None else Path(output)
    if target is not None:
        remove_leftovers(target)
    job = Scoring(dict(zip(run_names(places), places, strict=True)), truth, target, judge, settings, page)
    results: list[Result] = []
    with reporter:
        reporter.start(len(items), 0, "evaluate")
        short = [item.name.rpartition("/")[2] for item in items]
        for item, name in zip(items, short, strict=True):
            results += (found := job.results(item, alone=short.count(name) == 1))
            reporter.step(any(result.error for result in found))
    for name in vars(settings):
        taken = any(name in each.takes for each in job.judges.values())
        if getattr(settings, name) is not None and job.judges and not taken:
            reporter.info(f"--{name} makes no difference to {', '.join(job.judges)}")
    report = EvaluationReport(tuple(job.runs), tuple(results), job.judges, truth)
    if target is not None:
        write_text(target / "scores.csv", to_csv(report.rows()))
        write_text(target / "scores.json", to_json(report.to_dict()))
        write_text(target / "report.md", report.markdown())
    if page is not None:
        page.write(report, to_json(report.to_dict()), {run: saved_config(place) for run, place in job.runs.items()})
    for warning in report.warnings:
        reporter.info(f"warning: {warning}")
    for result in report.failed:
        reporter.error(f"{result.run} {result.scene}: {result.error}")
    return report


def new_page(command: Command, values: Values, output: Path | None) -> Page | None:
    """The page that ``HTML`` asks for; ConfigError where there is no place for it."""
    if not values["html"]:
        return None
    if output is None:
        raise ConfigError("--html wants --output, the folder to write the page into")
    from depthcli.batch.resources import parse_bytes
    from depthcli.report.page import Page

    return Page(output, command.line(values), parse_bytes(values["html_budget"], "--html-budget"))


def _scenes(truth: Path, kinds: Any, layout: str | None, scenes: Sequence[str], reporter: Reporter) -> list[Scene]:
    """All scenes with ground truth, and those that cannot be used; of a file, the scene whose truth it is."""
    from depthcli.data.walk import discover_scenes, scene_with_file

    if truth.is_file():
        holding = scene_with_file(truth)
        return [] if holding is None else [holding]
    found = discover_scenes(truth, kinds, layout, scenes, reporter.info)
    found = [item for item in found if item.problem or item.has_truth]
    if not any(item.has_truth and not item.problem for item in found):
        if found:
            raise InputError(found[0].problem)
        raise InputError(f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)")
    return found


COMMAND = EvaluateCommand()
