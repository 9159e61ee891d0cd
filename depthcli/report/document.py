"""``report.md``: an evaluation as text, with plots of its confidence curves."""

from __future__ import annotations

from collections.abc import Mapping

from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import ScoredMap, Viewer
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.report.plots import curve_plot
from depthcli.report.tables import report_tables
from depthcli.show.table import markdown_code, markdown_link, markdown_text
from depthcli.show.view import draw_legend, kind_colors


class Document(Viewer):
    """Tables as Markdown, and plots of confidence curves as SVG."""

    file = "report.md"
    needed = True

    def add_map(self, scored: ScoredMap) -> None:
        result = scored.result
        for (region, of), plot in result.plots.items():
            lines = {c.confidence: c.line for c in result.curves if (c.region, c.of) == (region, of)}
            write_text(self.folder / plot, curve_plot(lines, f"{result.run}: {result.scene}, {region}", of))

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write ``report.md``, and legends of the error pictures."""
        write_text(self.folder / self.file, _markdown(report))
        drawn = [protocol for protocol in report.protocols.values() if protocol.presentation.error_pictures]
        for protocol in drawn if any(not result.error for result in report.results) else []:
            names = protocol.presentation.pixel_kind_names
            legend = draw_legend(zip(names, kind_colors().tolist(), strict=True))
            which = f"_{protocol.name}" if len(drawn) > 1 else ""
            write_png(self.folder / "errors" / f"legend{which}.png", legend)


def _markdown(report: EvaluationReport) -> str:
    """Return all tables and warnings, with links to error pictures and plots."""
    runs = ", ".join(map(markdown_code, report.runs))
    out = ["# Evaluation", "", f"Ground truth: {markdown_code(report.truth)}. Runs: {runs}.", ""]
    if report.plugins:
        used = ", ".join(f"{package} {version}" for package, version in report.plugins.items())
        out += [f"Plug-ins: {markdown_code(used)}.", ""]
    out += [f"**Warning:** {markdown_text(line)}\n" for line in report.warnings()]
    out += [table.markdown() for table in report_tables(report)]
    drawn = {p.name: p.presentation.legend for p in report.protocols.values() if p.presentation.error_pictures}
    out += ["## Error pictures" if drawn else "## Curves", ""]
    out += [f"{name}: {legend}.\n" for name, legend in drawn.items()]
    if drawn and any(r.bounds for r in report.results):
        out += ["Pictures of bounds, below, show errors beyond the bound in the colors of incorrect pixels.\n"]
    for r in report.results:
        if not r.error:
            scene = markdown_text(r.scene)
            out += [f"{markdown_text(r.run)}, {scene}:", ""]
            out += [f"![{scene}]({markdown_link(r.picture)})", ""] if r.protocol in drawn else []
            out += [f"![bound]({markdown_link(r.bound_picture)})", ""] if r.protocol in drawn and r.bounds else []
            out += [f"![{of}, {region}]({markdown_link(path)})\n" for (region, of), path in r.plots.items()]
    return "\n".join(out)
