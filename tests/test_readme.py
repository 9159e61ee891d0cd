"""README, CONTRIBUTING and pages: the files and options that they name exist, the example of a Makefile works."""

import os
import re
import shutil
import sys
from pathlib import Path

import pytest

import depthcli
from tests.command_line import ended, statuses
from tests.files import laid

ROOT = Path(__file__).resolve().parent.parent
README, CONTRIBUTING = ((ROOT / name).read_text("utf-8") for name in ("README.md", "CONTRIBUTING.md"))


def test_named_files_exist():
    text = "\n".join([README, CONTRIBUTING, *(page.read_text("utf-8") for page in (ROOT / "docs").rglob("*.md"))])
    names = set(re.findall(r"(?<![\w/])((?:scripts|depthcli|tests|configs|docs)/[\w./-]*[\w/])", text))
    missing = {name for name in names if not (ROOT / name).exists()}
    assert missing == {"depthcli/methods/stereo/cost/squared_difference.py"}  # the example of CONTRIBUTING.md


@pytest.mark.system
@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_the_makefile_evaluates_although_a_scene_fails(made_scenes: Path, tmp_path: Path):
    for name in ("planes_0", "planes_1"):
        shutil.copytree(made_scenes / name, tmp_path / "scenes" / name)
    damaged = tmp_path / "scenes/planes_0/left.png"
    image = damaged.read_bytes()
    damaged.write_bytes(b"damaged")
    makefile = (ROOT / "docs/batches.md").read_text("utf-8").partition("```make file=Makefile\n")[2].partition("```")[0]
    laid(tmp_path, {"experiments/small.yaml": "base: opencv-bm\nblock: 7\n", "Makefile": makefile})
    program = tmp_path / "bin/depthcli"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m depthcli "$@"\n')
    program.chmod(0o755)
    environment = os.environ | {"PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}

    def make(code: int, *words: str) -> str:
        done = ended(code, "make", *words, cwd=tmp_path, env=environment)
        return done.stdout + done.stderr

    assert "depthcli evaluate" in make(0)
    assert "planes_0" in (tmp_path / "results/report.md").read_text()
    assert "up to date" in make(0)
    assert statuses(tmp_path / "runs/small")["planes_0"] == "failed"
    damaged.write_bytes(image)
    make(0, "-B")
    assert statuses(tmp_path / "runs/small")["planes_0"] == "done"
    (tmp_path / "experiments/small.yaml").write_text("base: opencv-bm\nno_such_key: 1\n")
    assert "no_such_key" in make(2)  # a wrong config stops make


def test_one_version_everywhere():
    version = re.escape(depthcli.__version__)
    citation, changes = ((ROOT / name).read_text("utf-8") for name in ("CITATION.cff", "CHANGELOG.md"))
    found = re.search(rf"^version: {version}\ndate-released: (\S+)$", citation, re.M)
    assert found, "CITATION.cff"
    assert re.search(r"^## (.*)$", changes, re.M)[1] in (f"{depthcli.__version__} - {found[1]}", "Unreleased")  # type: ignore[index]
    assert re.search(rf"version = {{{version}}}", README)


def test_the_manual_and_the_readme_are_short():
    """Words by hand: without the reference, tables that scripts write, output of commands, and the template."""
    pages = [page for page in (ROOT / "docs").rglob("*.md") if not {"reference", "plugin_template"} & set(page.parts)]
    pages += [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")]
    texts = [page.read_text("utf-8") for page in pages]
    by_hand = [re.sub(r"<!-- begin .*?<!-- end -->", "", text, flags=re.S) for text in texts]
    outputs = re.compile(r"^```console.*?^```$", re.M | re.S)
    commands = [outputs.sub(lambda block: "\n".join(re.findall(r"^\$ .*", block[0], re.M)), text) for text in by_hand]
    assert sum(len(text.split()) for text in commands) <= 22_000
    assert len(README.splitlines()) <= 130
