"""Texts that the program writes, compared whole with files kept beside the tests; ``pytest --renew`` writes them anew.

A test asserts the kind of an error, exit codes and values. The sentences are in ``tests/messages.txt`` under the name
of the test: a change of words changes that file alone, and is looked at there.
"""

import csv
import json
import os
import re
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import read_image
from depthcli.kernels.cache import cache_folder

TESTS = Path(__file__).resolve().parent
MEASURED = ("seconds", "peak_memory", "version")
MESSAGES = TESTS / "messages.txt"
Same = Callable[[str, str], None]
temporary = Path("/tmp")
given: dict[str, list[str]] = {}  # by test, of this process
collected: set[str] = set()  # tests with all their parameters, those that are not run included


def read_messages() -> dict[str, list[str]]:
    """Return the lines kept for each test."""
    kept, test = dict[str, list[str]](), ""
    for line in MESSAGES.read_text("utf-8").splitlines() if MESSAGES.is_file() else ():
        if line.startswith("    "):
            kept[test].append(line[4:])
        else:
            kept[test := line] = []
    return kept


def renew() -> None:
    """Keep what was given, and drop tests and parameters that are gone."""
    kept = {test: lines for test, lines in sorted({**read_messages(), **given}.items()) if lines}
    whole = {test.partition("[")[0] for test in collected}

    def exists(test: str) -> bool:
        function = test.partition("[")[0]
        file, *_, name = function.split("::")
        path = TESTS.parent / file
        return test in collected if function in whole else path.is_file() and f"def {name}(" in path.read_text("utf-8")

    text = "".join(f"{test}\n" + "".join(f"    {line}\n" for line in kept[test]) for test in kept if exists(test))
    MESSAGES.write_text(text, "utf-8")


def told(text: str) -> str:
    """Note a message, or what a command wrote, for the comparison at the end of the test; return it.

    Folders of the test, of the checkout and of kernels, measured times, and lines that depend on the machine (of
    kernels that are compiled, of the progress of a slow run) are left out of the comparison.
    """
    test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" (")[0]
    given.setdefault(test, []).extend(line.rstrip() for line in (_plain(text).strip() or "(nothing)").splitlines())
    return text


def _plain(text: str) -> str:
    for place in (temporary, Path(tempfile.gettempdir(), "tmp")):
        text = re.sub(re.escape(str(place)) + r"(/?[^/\s:',\"`]+)?", "TMP", text)
    for folder, name in ((cache_folder(), "KERNELS"), (TESTS.parent, "ROOT")):
        text = text if folder is None else text.replace(str(folder), name)
    progress = r"[\w-]+: \d+ of \d+ scenes(, \d+ failed)?|(first use of these settings|compiled \d+ kernels) .*"
    text = re.sub(rf"^({progress})\n", "", text, flags=re.M)
    text = re.sub(rf"\b{re.escape(Path(sys.executable).name)} (ended|was)\b", r"python \1", text)  # python3, ...
    text = re.sub(r"^(Traceback .*\n)(?:[ ~^].*\n)+", r"\1", text, flags=re.M)  # its lines change with the code
    return re.sub(r"\b\d+(\.\d+)? (s|min|ms)\b", r"N \2", text)


@contextmanager
def saying(kind: type[BaseException]) -> Iterator[pytest.ExceptionInfo[Any]]:
    """Assert that an exception of this kind is raised, with the words kept for the test."""
    with pytest.raises(kind) as caught:
        yield caught
    told(str(caught.value))


def refused(kind: type[Exception], call: Callable[..., object], /, *arguments: Any, **options: Any) -> str:
    """Assert that the call ends with an error of one line, with the words kept for the test; return the line."""
    with saying(kind) as caught:
        call(*arguments, **options)
    assert str(caught.value).isprintable()
    return str(caught.value)


def warned(call: Callable[..., Any], /, *arguments: Any, **options: Any) -> tuple[Any, list[str]]:
    """Return what the call returns, and its warnings of files."""
    with collected_warnings() as lines:
        return call(*arguments, **options), lines


def same_text(name: str, text: str, renewed: bool) -> None:
    """Compare a whole output with ``tests/outputs/NAME``, or write that file."""
    file = TESTS / "outputs" / name
    plain = "".join(f"{line.rstrip()}\n" for line in _plain(text).splitlines())
    if renewed:
        file.write_text(plain, "utf-8")
    assert plain == file.read_text("utf-8"), f"look at tests/outputs/{name}; pytest --renew writes it"


def _values(file: Path) -> Any:
    if file.suffix in (".pfm", ".png"):
        return read_plane(file) if file.suffix == ".pfm" else read_image(file)
    import SimpleITK

    return SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(file)))


def svg_words(file: Path) -> str:
    """Return the words of a plot on a line: title, axes, marks, legend."""
    texts = ("".join(each.itertext()) for each in ElementTree.parse(file).iter() if each.tag.endswith("text"))
    return f"{file.name}: {', '.join(text.strip(chr(0x200B)) for text in texts)}"


def same_figures(
    key: str, folder: Path, renewed: bool, endings: tuple[str, ...] = (".pfm", ".nii.gz"), columns: Sequence[str] = ()
) -> None:
    """Compare every map below a folder with the figures of ``key`` in ``tests/outputs/maps.json``, or write them.

    A map has the share of its pixels with a value, their mean, and the mean step to the next one (on the right, or of
    the next channel). Names of ``columns`` are kept, too.
    """
    found: dict[str, Any] = {"columns": " ".join(columns)} if columns else {}
    for path in sorted(path for path in folder.rglob("*") if path.name.endswith(endings)):
        values = np.array(_values(path), np.float64)
        values[~np.isfinite(values)] = np.nan
        known, steps = (each[np.isfinite(each)] for each in (values, np.diff(values, axis=-1)))
        figures = known.size / values.size, *(each.mean() if each.size else 0.0 for each in (known, np.abs(steps)))
        found[path.relative_to(folder).as_posix()] = [float(f"{figure:.5g}") for figure in figures]
    file = TESTS / "outputs" / "maps.json"
    kept = json.loads(file.read_text("utf-8"))
    if renewed:
        kept[key] = found
        lines = [f' "{name}": {json.dumps(kept[name])}' for name in sorted(kept)]
        file.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")
    near = {name: pytest.approx(each, 1e-3, 1e-6) for name, each in kept[key].items() if name != "columns"}
    assert found == kept[key] | near


def steady_json(text: str, measured: tuple[str, ...] = MEASURED) -> str:
    """Return a JSON document without measured times and memory, floats of 5 digits, long curves as sums."""

    def steady(value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {name: steady(each, "seconds" if key == "seconds" else name) for name, each in value.items()}
        if isinstance(value, list) and len(value) > 12 and all(isinstance(each, int | float) for each in value):
            return f"{len(value)} numbers, {value[0]:.5g} to {value[-1]:.5g}, sum {sum(value):.5g}"
        if isinstance(value, list):
            return [steady(each, key) for each in value]
        if isinstance(value, str):
            return _plain(value)  # before the lines are cut: folders differ in length
        if key.startswith(measured):
            return None if value is None else "measured"
        return float(f"{value:.5g}") if isinstance(value, float) else value

    return _json_lines(steady(json.loads(text)))


def _json_lines(value: Any, margin: str = "\n") -> str:
    short = json.dumps(value, ensure_ascii=False)
    if len(short) < 200 or not isinstance(value, dict | list):
        return short
    named = [f"{json.dumps(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
    parts = value.values() if isinstance(value, dict) else value
    lines = [margin + " " + name + _json_lines(each, margin + " ") for name, each in zip(named, parts, strict=True)]
    return short[0] + ",".join(lines) + margin + short[-1]


def steady_csv(text: str) -> str:
    """Return the lines of a CSV file in which measured times and memory are left out, floats rounded to 5 digits."""
    header, *rows = csv.reader(text.splitlines())
    kept = [k for k, name in enumerate(header) if not name.startswith(MEASURED)]
    cells = [[row[k] for k in kept] for row in (header, *rows)]
    rounded = [[f"{float(c):.5g}" if re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", c) else c for c in row] for row in cells]
    return "\n".join(map(",".join, rounded))
