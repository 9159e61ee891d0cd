"""The documentation: its reference is up to date, its links lead somewhere, its examples run."""

import ast
import json
import os
import re
import runpy
import sys
from pathlib import Path

import _docs_examples
import _docs_links
import docs_reference
import figures
import pytest

import depthcli
from depthcli.cli import command_of
from depthcli.commands import config_model, own_names
from depthcli.core.config_file import dump_config, find_config, list_presets, load_config
from depthcli.core.errors import EXIT_CODES
from depthcli.core.maps import DEPTH_STATUS_HELP, STATUS_HELP
from depthcli.core.method import Family
from depthcli.evaluation import protocols
from depthcli.io.formats.map_format import map_formats
from depthcli.io.scenes.find import ALL_KINDS
from depthcli.methods.registration.search import MEASURES
from tests.command_line import ended
from tests.files import laid
from tests.golden import saying

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


@pytest.mark.parametrize("notebook", sorted(DOCS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_run(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    """Every cell runs in order, from nothing, and none carries an output that could be out of date."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    names: dict[str, object] = {}
    for cell in (each for each in json.loads(notebook.read_text("utf-8"))["cells"] if each["cell_type"] == "code"):
        assert not cell["outputs"]
        exec(compile("".join(cell["source"]), notebook.name, "exec"), names)
    if notebook.stem == "first_steps":
        assert "accurate: " in capsys.readouterr().out
        assert (tmp_path / "first_steps" / "points.ply").stat().st_size > 1_000_000


def test_every_name_of_the_program_is_in_the_reference():
    """Commands with options, presets, methods with fields, layouts, protocols, columns, bits: asked of the code."""
    pages = docs_reference.pages()
    for name in own_names():
        command = command_of(name)
        section = pages["command_line"].partition(f"### `depthcli {name}`\n")[2].partition("\n###")[0]
        for option in command.params:
            assert (option.help or "").split("|")[0].rstrip() in section, (name, option.name)
    for command, preset, _ in list_presets():
        assert f"(../../configs/{command}/{preset}.yaml)" in pages["presets"]
    sources = (path for path in (ROOT / "depthcli").rglob("__init__.py") if "method_of(" in path.read_text("utf-8"))
    families = {".".join(path.parent.relative_to(ROOT).parts) for path in sources}
    assert families <= set(docs_reference.METHOD_PACKAGES) | {"depthcli.core"}
    for package in docs_reference.METHOD_PACKAGES:
        family = Family.of(package)
        text = "".join(text for page, text in pages.items() if page.startswith("methods/") and f"`{package}`" in text)
        for name in family.own_names:
            section = text.partition(f"## `{name}`\n")[2].partition("\n## ")[0]
            assert section, (package, name)
            assert all(f"| `{field}` |" in section for field in family.load(name).model_fields), (package, name)
    for found, page in (
        ([each.name for each in ALL_KINDS.with_plugins().rows], "data"),
        (protocols.names(), "protocols"),
        ([str(int(bit)) for bit in (*STATUS_HELP, *DEPTH_STATUS_HELP)], "outputs"),
        (map(str, EXIT_CODES), "outputs"),
        ([name for rows in docs_reference.COLUMNS.values() for name in rows], "columns"),
        (map_formats(), "data"),
        (MEASURES, "methods/registration_feature"),
    ):
        assert all(f"`{name}`".replace("|", "\\|") in pages[page] for name in found), page
    assert all(f"depthcli.{name}" in pages["python"] for name in depthcli.__all__ if name != "__version__")


def test_the_reference_is_up_to_date():
    pages = {DOCS / "reference" / f"{name}.md": text for name, text in docs_reference.pages().items()}
    written = {file: file.read_text("utf-8") for file in (DOCS / "reference").rglob("*.md")}
    stale = {file.name for file in pages.keys() | written.keys() if pages.get(file) != written.get(file)}
    assert not stale, "run scripts/docs_reference.py"


def test_every_column_of_a_preset_is_explained():
    """By the table of its command; the N of ``weight_N`` stands for anything."""
    for preset, figures_of in json.loads((ROOT / "tests" / "outputs" / "maps.json").read_text("utf-8")).items():
        words = {"Every run", preset.partition(" ")[0]}
        headings = [key for title, rows in docs_reference.COLUMNS.items()
                    if words & {title, *re.split(", | ", title)} for key in rows]  # fmt: skip
        names = "|".join(name for key in headings for name in key.partition(" [")[0].split(", "))
        known = re.compile(re.sub(r"NAME|STAGE|N\b", ".+", names))
        missing = [name for name in figures_of.get("columns", "").split() if not known.fullmatch(name)]
        assert not missing, preset


def test_every_link_leads_somewhere_in_the_repository_and_pictures_are_small():
    """Pages, headings, pictures and other files, as a code host shows them."""
    pages = [*ROOT.glob("*.md"), *DOCS.rglob("*.md"), ROOT / "scripts" / "README.md"]
    assert not list(_docs_links.dead_links(ROOT, pages))
    pictures = (file for end in ("png", "svg", "webp") for file in (DOCS / "static").rglob(f"*.{end}"))
    assert sum(file.stat().st_size for file in pictures) <= 4_000_000


def test_dead_links_are_found(tmp_path: Path):
    alive = "[](b.md) [](b.md#a-b-c-d) [](b.md#twice-1) [](https://x.org/y) `[](code.md)`\n```sh\n[](block.md)\n```\n"
    dead = "[](#none) [](b.md#no-heading) ![](c.png) [](../outside.md)"
    other = "# A `b c`, d\n# Twice\n# Twice\n```\n# no heading\n```\n"
    laid(tmp_path, {"b.md": other, "a.md": f"{alive}# Own\n[](#own) {dead}"})
    (tmp_path.parent / "outside.md").touch()
    found = [line.removeprefix("a.md: ") for line in _docs_links.dead_links(tmp_path, [tmp_path / "a.md"])]
    assert found == ["#none", "b.md#no-heading", "c.png", "../outside.md"]


def test_measured_tables_have_their_place():
    """The tables of figures.yaml are those between markers, with the columns that they have there."""
    pages = "".join(page.read_text("utf-8") for page in figures.PAGES)
    for name, table in figures.SETTINGS["tables"].items():
        shown = pages.partition(f"<!-- begin {name} -->\n\n")[2].partition("\n")[0]
        assert shown == f"| {' | '.join(map(str, table['columns']))} |", name
        assert table["run"] in figures.SETTINGS["runs"]


def test_the_tables_of_the_thesis_show_what_was_measured():
    thesis = runpy.run_path(str(ROOT / "scripts" / "thesis"))
    measured = thesis["Measured"](json.loads((DOCS / "static" / "thesis" / "measured.json").read_text("utf-8")))
    written = thesis["written"](measured, set("234567"))
    for file, text in written.items():
        assert file.read_text("utf-8") == text, "run scripts/thesis DATA --page"
    sheets = set((DOCS / "static" / "thesis").glob("*.csv"))
    assert sheets == written.keys() - set(thesis["PAGES"])
    page = (DOCS / "thesis.md").read_text("utf-8")
    assert all(f"](static/thesis/{file.name})" in page for file in sheets)


def test_the_config_keys_on_the_page_of_the_thesis_exist():
    """Each word of the equations' config columns and of the "Config:" lines is a key or value of a chapter's preset."""
    for chapter in (DOCS / "thesis.md").read_text("utf-8").split("\n## Chapter ")[1:]:
        if chapter.startswith("1:"):
            continue  # it has no method of its own
        found = re.search(r"^ *depthcli (\S+) thesis/", chapter, re.MULTILINE)
        assert found
        chapters = f"thesis/ch{chapter[0]}"
        presets = [name for command, name, _ in list_presets() if command == found[1] and name.startswith(chapters)]
        model = config_model(found[1])
        assert model and presets
        known = "".join(dump_config(load_config(model, find_config(found[1], name))) for name in presets)
        rows = chapter.partition("| equation | config")[2].partition("\n\n")[0].splitlines()[1:]
        shown = "\n".join(row.split(" | ")[1] for row in rows if " | " in row)
        shown += chapter.partition(" Config: ")[2].partition("\n\n")[0]
        words = {word for code in re.findall(r"`([^`]+)`", shown) for word in re.findall(r"[a-z]\w+", code)}
        assert words and words <= set(re.findall(r"\w+", known)), (chapter[:1], words - set(re.findall(r"\w+", known)))


def test_a_table_is_taken_from_the_output_of_a_script():
    text = "## Some title, %\n\n| name | a | b |\n| --- | ---: | ---: |\n"
    text += "| x | **1.234** | 2 |\n| y | 3 | <u>4.5</u> |\n"
    settings = {"title": "Some", "columns": {"method": "name", "a / b": "a & b"}, "rows": {"y": "Y", "x": "X"}}
    settings |= {"fixed": [["Z", 9]]}
    table = figures.markdown(figures.selected(figures.tables(text), settings))
    assert table == "| method | a / b |\n| --- | ---: |\n| Y | 3 / 4.5 |\n| X | 1.234 / 2 |\n| Z | 9 |"
    page = figures.renewed("a\n<!-- begin t -->\nold\n<!-- end -->\nb\n", {"t": table})
    assert page == f"a\n<!-- begin t -->\n\n{table}\n\n<!-- end -->\nb\n"


@pytest.fixture
def page(tmp_path: Path):
    setup = tmp_path / "setup.sh"
    setup.write_text("echo made > made.txt\n")
    return lambda text: _docs_examples.Page("page.md", text, tmp_path / "run", setup)


def test_blocks_of_a_page_run_in_order_and_their_output_is_written(page):
    text = page(
        "```yaml file=a/b.yaml\nbase: fast\n```\n"
        "```console lines=2\n$ cat a/b.yaml made.txt; pwd\n$ seq 4\nold output\n```\n"
        "```python\nx = 2\n```\n```python\nprint(x + 1)\n```\n\n```text\nold\n```\n"
        "```sh exit=3\nexit 3\n```\n```text\nas it is\n```\n"
    ).run()
    assert text == (
        "```yaml file=a/b.yaml\nbase: fast\n```\n"
        "```console lines=2\n$ cat a/b.yaml made.txt; pwd\nbase: fast\nmade\n...\n$ seq 4\n1\n2\n...\n```\n"
        "```python\nx = 2\n```\n```python\nprint(x + 1)\n```\n\n```text\n3\n```\n"
        "```sh exit=3\nexit 3\n```\n```text\nas it is\n```\n"
    )


def test_outputs_are_compared_without_what_differs_from_run_to_run():
    table = "scene  size  seconds  memory\na      4x3      0.12  10 MiB\n\ntotal 3.00 px in 2.1 s\n"
    assert _docs_examples.same_output(table, table.replace("0.12  10", "9.99  99").replace("2.1 s", "7 s"))
    assert _docs_examples.same_output(table, table.replace("3.00", "3.05"))
    for old, new in (("3.00", "3.40"), ("4x3", "4x5"), ("total", "sum"), ("a ", "b ")):
        assert not _docs_examples.same_output(table, table.replace(old, new))


@pytest.mark.parametrize("block", [
    "```console\n$ false\n```\n",
    "```sh exit=2\nexit 3\n```\n",
    "```python\nraise ValueError('no')\n```\n",
    "```console\nnothing\n```\n",
    "```yaml\na: 1\n```\n",
    "```sh quiet\ntrue\n```\n",
    "- a\n\n  ```sh\n  true\n  ```\n",
])  # fmt: skip
def test_an_example_that_fails_stops_the_page(page, block: str):
    with saying(_docs_examples.ExampleError):
        page("\n" + block).run()


@pytest.mark.system
@pytest.mark.parametrize("name", ["tutorial", "rig", "batches"])
def test_pages_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A few pages; ``scripts/docs --check`` runs all of them."""
    for key, value in _docs_examples.environment(tmp_path).items():
        monkeypatch.setenv(key, value)
    text = (DOCS / f"{name}.md").read_text("utf-8")
    shown = _docs_examples.Page(f"{name}.md", text, tmp_path / "run", DOCS / "examples" / f"{name}.sh").run()
    pairs = zip(_docs_examples.outputs(text), _docs_examples.outputs(shown), strict=True)
    assert [new for old, new in pairs if not _docs_examples.same_output(old, new)] == []


@pytest.mark.system
def test_the_overview_is_drawn_as_it_is_committed():
    """One picture; ``docs/examples/pictures.py --check`` compares all."""
    ended(0, sys.executable, DOCS / "examples" / "pictures.py", "--check", "--only", "overview")


@pytest.mark.parametrize("start", sorted((ROOT / "depthcli").rglob("__init__.py")), ids=lambda file: file.parent.name)
def test_the_table_of_a_package_names_its_modules(start: Path):
    """A package whose docstring has a table of modules names all public ones, and no module that is gone."""
    doc = ast.get_docstring(ast.parse(start.read_text("utf-8"))) or ""
    if not re.search(r"^(\| module|=====)", doc, re.M):
        return
    folder = start.parent
    modules = {file.stem for file in folder.glob("*.py")} | {file.parent.name for file in folder.glob("*/__init__.py")}
    named = set(re.findall(r"``(\w+)/?``", " ".join(re.findall(r"^\|? *``.*?(?: \||  )", doc, re.M))))
    assert {name for name in modules if not name.startswith("_")} <= set(re.findall(r"\w+", doc))
    folders = {each.name for each in folder.iterdir() if each.is_dir()}
    assert named <= modules | folders | {file.stem for file in folder.glob("pipeline/*.py")}
