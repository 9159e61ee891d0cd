"""The page in a real browser: clicks, keys and what the pointer reads, against the arrays themselves."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.evaluation.evaluate import Choices, evaluate_runs, scenes_with_truth
from depthcli.io.formats.disparity import read_disparity, read_plane
from depthcli.report.packing import unpack
from depthcli.report.page import Page
from tests.report.conftest import ODD, SHAPE, truth_of

pytestmark = pytest.mark.system

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    driver = pytest.importorskip("playwright.sync_api", reason="no playwright, which drives the browser")
    found = next((path for name in _NAMES if (path := shutil.which(name))), None)
    with driver.sync_playwright() as playwright:
        own = Path(playwright.chromium.executable_path)
        if found is None and not own.exists():
            pytest.skip(f"no browser: none of {', '.join(_NAMES)}, nor playwright's own")
        launched = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield launched
        launched.close()


class Visit:
    """A page that was opened, with what it said and asked for."""

    def __init__(self, browser: Any, file: Path, width: int = 1280) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 860})
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.asked: list[str] = []
        # Chromium's advice on getImageData concerns the tests, which read colors back.
        self.page.on("console", lambda m: None if "getImageData" in m.text else self.said.append(m.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("dialog", lambda dialog: self.said.append(f"dialog {dialog.message}"))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())

    def ready(self, number: int) -> None:
        self.page.wait_for_selector(f"#viewer[data-ready='{number}']", timeout=10_000)

    def point(self, x: int, y: int, panel: int = 0) -> None:
        """Move onto a pixel of a picture that is fitted into its panel."""
        box = self.page.locator("#stage canvas").nth(panel).bounding_box()
        zoom = min(box["width"] / SHAPE[1], box["height"] / SHAPE[0])
        left = box["x"] + (box["width"] - SHAPE[1] * zoom) / 2
        top = box["y"] + (box["height"] - SHAPE[0] * zoom) / 2
        self.page.mouse.move(left + (x + 0.5) * zoom, top + (y + 0.5) * zoom)

    def reading(self) -> tuple[str, list[list[str]]]:
        rows = self.page.locator("#readout tbody tr").all()
        return self.page.locator("#readout div").inner_text(), [r.locator("th, td").all_inner_texts() for r in rows]

    def color(self, panel: int = 0, x: float = 0.5, y: float = 0.5) -> list[int]:
        """RGB of a canvas at a share of its width and height."""
        script = """([n, x, y]) => {
          const c = document.querySelectorAll('#stage canvas')[n];
          return [...c.getContext('2d').getImageData(c.width * x, c.height * y, 1, 1).data.slice(0, 3)];
        }"""
        return self.page.evaluate(script, [panel, x, y])

    def show(self, name: str) -> None:
        """Open the viewer on a scene."""
        number = self.page.locator("article h3").all_inner_texts().index(name)
        self.page.evaluate(f"location.hash = '#scene-{number}/1'")
        self.ready(number)

    def close(self) -> None:
        assert self.said == []
        self.context.close()


def test_values_under_the_pointer(browser: Any, made: Path, runs: list[Path]):
    visit = Visit(browser, made / "report.html")
    for seed, name in enumerate(("plain", ODD)):
        visit.show(name)
        assert visit.page.locator("#which option:checked").inner_text() == name
        truth = truth_of(seed)
        maps = [read_disparity(run / name / "disp_left.pfm") for run in runs]
        confidence, bound = (read_plane(runs[0] / name / f"{one}.pfm") for one in ("confidence_lrd", "bound"))
        for x, y in ((3, 5), (25, 12), (47, 35), (8, 0)):
            visit.point(x, y)
            line, rows = visit.reading()
            assert line.startswith(f"x {x}, y {y} ")
            shown = float(re.search(r"true disparity ([\d.]+) px", line)[1])
            assert shown == pytest.approx(truth[y, x], abs=0.0051)
            assert ("occluded" in line) == (x < 8)
            for row, values in zip(rows, maps, strict=True):
                value, error = values[y, x], abs(values[y, x] - truth[y, x])
                if np.isnan(value):
                    assert (row[1], row[3]) == ("-", "no value")
                    continue
                if "scale" not in row[1]:
                    assert float(row[1]) == pytest.approx(value, abs=0.0055)
                    assert float(row[2]) == pytest.approx(error, abs=0.006)
                assert row[3] == ("incorrect" if error > 1 else "correct") + (", occluded" if x < 8 else "")
            assert float(rows[0][4]) == pytest.approx(bound[y, x], abs=0.01)
            assert rows[0][5] == ("occluded, filled" if x < 8 else "measured")
            assert float(rows[0][6].split(",")[0].removeprefix("lrd ")) == pytest.approx(confidence[y, x], abs=5e-4)
    visit.point(30, 4)
    assert visit.reading()[1][0][4] == "above the scale"
    visit.point(2, 1)
    assert "truth unknown" in visit.reading()[0]
    visit.close()


def test_keys_flip_layers_and_scenes(browser: Any, made: Path):
    visit = Visit(browser, made / "report.html")
    visit.page.locator(".matrix.on tbody td a").first.click()
    visit.ready(0)
    keys, title = visit.page.keyboard, visit.page.locator("#stage figcaption")
    seen = []
    for key in "12ti":
        keys.press(key)
        seen.append((title.inner_text(), visit.color()))
    assert [name for name, _ in seen] == ["good", 'bad "<b>"', "truth", "image"]
    assert len({tuple(color) for _, color in seen}) == 4
    keys.press("2")
    keys.press("1")
    for key, layer in (("e", "error"), ("m", "map"), ("b", "bound"), ("s", "status"), ("c", "confidence")):
        keys.press(key)
        assert visit.page.locator("#layers [aria-pressed=true]").inner_text() == layer
        if layer == "bound":
            legend = visit.page.locator("#legend").inner_text()
            assert re.match(r"bound of the error [\d.]+\s*[\d.]+\s*[\d.]+ px", legend)
            assert visit.color(0, 0.4)[1] < visit.color(0, 0.6)[1]
    keys.press("w")
    keys.press("1")
    keys.press("Shift+Digit2")
    assert title.inner_text() == 'good | bad "<b>"'
    keys.press("m")
    visit.page.locator("#swipe").fill("1000")
    left = visit.color()
    visit.page.locator("#swipe").fill("0")
    assert visit.color() != left
    keys.press("a")
    assert title.all_inner_texts() == ["image", "truth", "good", 'bad "<b>"']
    before = visit.color(1)
    visit.point(30, 10, panel=2)
    visit.page.mouse.wheel(0, -600)
    assert visit.color(1) != before  # all panels move together
    keys.press("r")
    assert visit.color(1) == before
    keys.press("ArrowRight")
    visit.ready(1)
    keys.press("Escape")
    assert not visit.page.locator("#viewer").is_visible()
    visit.close()


def test_tables_sort_and_choose(browser: Any, made: Path):
    visit = Visit(browser, made / "report.html")
    table = visit.page.locator(".matrix.on table")
    column = [1 + visit.page.locator(".matrix.on thead th").all_inner_texts().index("good")]
    for direction in (1, -1):
        table.locator("thead th").nth(column[0] - 1).click()
        cells = [float(t) for t in table.locator(f"tbody tr > :nth-child({column[0]})").all_inner_texts()]
        assert cells == sorted(cells)[::direction]
    visit.page.locator("select.region").select_option("all")
    visit.page.locator("select.metric").select_option("bad 2")
    assert visit.page.locator(".matrix.on caption").inner_text().endswith("bad 2, %, all")
    assert visit.page.locator(".matrix:visible").count() == 1
    visit.close()


def test_it_fits_a_phone_and_loads_nothing_from_a_network(browser: Any, made: Path):
    visit = Visit(browser, made / "report.html", width=390)
    assert visit.page.evaluate("document.documentElement.scrollWidth") <= 390
    visit.page.locator(".thumbs a").first.click()
    visit.ready(0)
    assert visit.page.locator("#stage").bounding_box()["height"] > 250
    assert visit.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert all(url.startswith(("data:", "file:")) for url in visit.asked)
    visit.close()


def test_full_size_comes_from_the_assets(browser: Any, tmp_path: Path, scenes: Path, runs: list[Path]):
    evaluate_runs(runs, scenes_with_truth(scenes), scenes, tmp_path, Choices(viewers=[Page(budget=2000)]))
    visit = Visit(browser, tmp_path / "report.html")
    visit.show("plain")
    visit.point(31, 17)
    assert visit.reading()[0].startswith("x 31, y 17 ")
    assert "of their size" not in visit.page.locator("#legend").inner_text()
    visit.close()
    shutil.rmtree(tmp_path / "assets")
    visit = Visit(browser, tmp_path / "report.html")
    visit.show("plain")
    assert "of their size" in visit.page.locator("#legend").inner_text()
    assert all("ERR_FILE_NOT_FOUND" in line for line in visit.said)
    visit.said.clear()
    visit.close()


def test_slices_are_stepped_through(browser: Any, volumes: Path):
    visit = Visit(browser, volumes / "report.html")
    data = json.loads(visit.page.locator("#data-0").text_content())
    names = [view["name"] for view in data["views"]]
    visit.show("pair_0")
    keys, where, start = visit.page.keyboard, visit.page.locator("#where"), data["start"]

    def shown(number: int) -> None:
        visit.page.locator("#where", has_text=re.compile(f"^{names[number]}$")).wait_for(timeout=10_000)
        visit.ready(0)

    assert where.inner_text() == names[start]
    keys.press("ArrowUp")
    shown(start + 1)
    keys.press("ArrowDown")
    shown(start)
    visit.page.locator("#slice").fill("0")
    shown(0)
    keys.press("ArrowDown")  # the first one: there is nothing before it
    keys.press("v")
    across = [k for k, view in enumerate(data["views"]) if view["axis"] == 1]
    middle = across[len(across) // 2]
    shown(middle)
    view = data["views"][middle]
    box = visit.page.locator("#stage canvas").first.bounding_box()
    visit.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    line, rows = visit.reading()
    sides = re.match(r"([RL]) ([\d.]+) mm, ([SI]) ([\d.]+) mm, coronal, ", line).groups()
    places = [float(number) * (1 if side in "RS" else -1) for side, number in zip(sides[::2], sides[1::2], strict=True)]
    column, row = (round((at - a[2]) / a[3]) for at, a in zip(places, view["axes"], strict=True))
    (run,) = view["runs"].values()
    assert float(rows[0][1]) == pytest.approx(unpack(run["values"])[row, column], abs=0.0051)
    error = float(re.search(r"error ([\d.]+) mm", line)[1])
    assert error == pytest.approx(unpack(view["truth"])[row, column], abs=0.0051)
    # Beneath a map lies the volume: all of it at no opacity, nothing at full.
    mixed = visit.color()
    visit.page.locator("#opacity").fill("0")
    beneath = visit.color()
    keys.press("i")
    assert visit.color() == beneath
    assert len(set(beneath)) == 1
    keys.press("1")
    keys.press("o")
    keys.press("o")
    assert visit.page.locator("#opacity").input_value() == "60"
    assert len({tuple(mixed), tuple(beneath), tuple(visit.color())}) == 3
    visit.close()
