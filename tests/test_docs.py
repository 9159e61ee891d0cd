"""The documentation's examples run."""

import json
import os
import re
import sys
from pathlib import Path

import _docs_examples
import docs_reference
import pytest

import depthcli
from depthcli.cli import command_of
from depthcli.commands import own_names
from depthcli.core.errors import EXIT_CODES
from depthcli.core.maps import DEPTH_STATUS_HELP, STATUS_HELP
from depthcli.core.method import Family
from depthcli.evaluation import protocols
from depthcli.io.formats.map_format import map_formats
from depthcli.io.layouts.all_kinds import ALL_KINDS
from depthcli.methods.registration.search import MEASURES
from depthcli.run.presets import list_presets

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


@pytest.mark.parametrize("notebook", sorted(DOCS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_run(
    notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Every cell runs in order, from nothing, and none carries an output that could be out of date."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    cells = [cell for cell in json.loads(notebook.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    names: dict[str, object] = {}
    for cell in cells:
        assert not cell["outputs"]
        exec(compile("".join(cell["source"]), f"{notebook.name}", "exec"), names)
    if notebook.stem == "first_steps":
        assert "accurate: " in capsys.readouterr().out
        assert (tmp_path / "first_steps" / "points.ply").stat().st_size > 1_000_000


def test_every_name_of_the_program_is_in_the_reference():
    """Commands with options, presets, methods with fields, layouts, protocols, columns, bits: asked of the code."""
    pages = docs_reference.pages()
    for name in own_names():
        command = command_of(name)
        section = pages["command_line"].partition(f"(command-{name})=")[2].partition("(command-")[0]
        for option in command.params:
            assert (option.help or "").split("|")[0].rstrip() in section, (name, option.name)
    for command, preset, _ in list_presets():
        assert f"### `{command} {preset}`" in pages["presets"]
    sources = (path for path in (ROOT / "depthcli").rglob("__init__.py") if "method_of(" in path.read_text("utf-8"))
    families = {".".join(path.parent.relative_to(ROOT).parts) for path in sources}
    assert families <= set(docs_reference.METHOD_PACKAGES) | {"depthcli.core"}
    for package in docs_reference.METHOD_PACKAGES:
        family = Family.of(package)
        text = "".join(text for page, text in pages.items() if page.startswith("methods/") and family.group in text)
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


def test_links_between_pages_lead_somewhere():
    """Headings are named as Sphinx's parser names them; what it does not check itself."""
    pages = {page.relative_to(DOCS).as_posix(): page.read_text("utf-8") for page in DOCS.rglob("*.md")}
    pages |= {f"reference/{name}.md": text for name, text in docs_reference.pages().items()}
    names = {
        page: {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in re.findall(r"^#+ (.*)$", text, re.M)}
        | set(re.findall(r"^\(([\w-]+)\)=$", text, re.M))
        for page, text in pages.items()
    }
    for page, text in pages.items():
        for path, name in re.findall(r"\]\((?!https?:)([^)#\s]*\.md|)#([^)\s]+)\)", text):
            target = os.path.normpath(os.path.join(os.path.dirname(page), path)) if path else page
            assert name in names[target], (page, path, name)


@pytest.fixture
def page(tmp_path: Path):
    def make(text: str) -> str:
        return _docs_examples.Page("page.md", text, tmp_path / "run", tmp_path / "pictures", "/pictures").run()

    return make


def test_blocks_of_a_page_run_in_order_and_show_what_they_print(page, tmp_path: Path):
    text = page(
        "```yaml file=a/b.yaml\nbase: fast\n```\n"
        "```console lines=2\n$ cat a/b.yaml; pwd\n$ seq 4\nold output\n```\n"
        "```python\nx = 2\n```\n```python hidden\nopen('p.png', 'wb').write(b'p')\n```\n```python\nprint(x + 1)\n```\n"
        "```sh exit=3\nexit 3\n```\n![p](p.png) ![q](q.png)\n```text\nas it is\n```\n"
    )
    assert "```{code-block} yaml\n:caption: a/b.yaml\n\nbase: fast\n```" in text
    assert "```console\n$ cat a/b.yaml; pwd\nbase: fast\n/home/you/depth\n$ seq 4\n1\n2\n...\n```" in text
    assert "```python\nx = 2\n```\n\n```python\nprint(x + 1)\n```\n\n```text\n3\n```\n```sh\nexit 3\n```\n" in text
    assert "![p](/pictures/p.png) ![q](q.png)\n```text\nas it is\n```" in text
    assert (tmp_path / "pictures/p.png").read_bytes() == b"p"


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("```console\n$ false\n```\n", "page.md:2: exit code 1, not 0"),
        ("```sh exit=2\nexit 3\n```\n", "exit code 3, not 2"),
        ("```python\nraise ValueError('no')\n```\n", "ValueError: no"),
        ("```console\nnothing\n```\n", "no line begins with"),
        ("```yaml\na: 1\n```\n", "neither run nor written"),
        ("```sh quiet\ntrue\n```\n", "unknown setting quiet"),
        ("- a\n\n  ```sh\n  true\n  ```\n", "a block is indented"),
    ],
)
def test_an_example_that_fails_stops_the_page(page, block: str, said: str):
    with pytest.raises(_docs_examples.ExampleError, match=re.escape(said)):
        page("\n" + block)


@pytest.mark.system
@pytest.mark.parametrize("name", ["tutorial", "how_to/rig_to_meters", "how_to/sweep"])
def test_pages_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A few pages; ``scripts/docs`` runs all of them."""
    monkeypatch.setenv("PATH", os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    text = (DOCS / f"{name}.md").read_text("utf-8")
    shown = _docs_examples.Page(f"{name}.md", text, tmp_path / "run", tmp_path / "pictures", "/pictures").run()
    images = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", shown)
    assert all(image.startswith("/pictures/") for image in images), images
