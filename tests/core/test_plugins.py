"""Plug-ins of files and of installed modules: how they are found, what is said of bad ones, what runs record."""

import importlib
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.commands import config_model
from depthcli.core import config_file as presets
from depthcli.core import plugins
from depthcli.core.config_file import dump_config, load_config
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.method import Family, used_plugins
from depthcli.core.plugins import load_plugin, registries, versions_here
from depthcli.core.yaml_source import parse_config
from depthcli.evaluation import protocols
from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_disparity, read_pfm, read_plane
from depthcli.problems.stereo import StereoConfig
from tests.command_line import rows
from tests.files import laid
from tests.golden import refused

COSTS = Family.of("depthcli.methods.stereo.cost")

FILE = '''
import numpy as np

from depthcli.commands import command
from depthcli.evaluation.protocols.eth3d import Eth3dProtocol
from depthcli.io.formats.map_format import MapFormat
from depthcli.io.scenes import Folder, Layout, StereoScene
from depthcli.methods.confidence import ConfidenceMeasure
from depthcli.methods.stereo.cost.census import Census


class WideCensus(Census):
    """A census whose window is wide."""

    aliases = ("AD", "WC-5")
    window: tuple[int, int] = (11, 3)


class MyText(MapFormat):
    suffixes = (".numbers",)

    def read(self, path):
        return np.loadtxt(path, ndmin=2)


class MyLayout(Layout):
    """Two images, where it is named."""

    kind = StereoScene
    about = "`left.png`, `right.png`"
    protocol = "my_protocol"

    def scenes(self, folder: Folder):
        if folder.requested != self.name or not folder.has("left.png", "right.png"):
            return []
        left, right = folder.path / "left.png", folder.path / "right.png"
        truth = folder.one("disp_left", (".pfm", ".numbers"))
        return [self.scene(folder, left=left, right=right, disparity_left=truth, **folder.meta.disparities())]


class MyMeasure(ConfidenceMeasure):
    """Spread of the costs."""

    def __call__(self, curves):
        return curves.costs.max(axis=-1).astype("float32") - curves.statistics.lowest


class MyProtocol(Eth3dProtocol):
    """ETH3D's under another name."""


@command()
def greet() -> int:
    """Greet the user."""
    print("good day")
    return 0


class _Hidden(Census):
    """Not registered."""
'''
SUBCLASSES = {
    "MyKeypoints": "algorithms.keypoints.surf.Surf",
    "MySegments": "algorithms.segmentation.slic.Slic",
    "MyChoice": "methods.fusion.choice.energy.LeastEnergyChoice",
    "MyFill": "methods.kinect.pipeline.nearest.NearestFill",
    "MyFeature": "methods.registration.feature.intensity.Intensity",
    "MySearch": "methods.registration.pipeline.search.RegistrationSearch",
    "MyWindow": "methods.stereo.aggregation.constant_window.ConstantWindow",
    "MyBoundary": "methods.stereo.boundary.gaussian.Gaussian",
    "MyWinner": "methods.stereo.optimization.winner_takes_all.WinnerTakesAll",
    "MyPipeline": "methods.stereo.pipeline.local.Local",
    "MyMedian": "methods.stereo.refinement.median.Median",
    "MyNearest": "methods.transparent.pipeline.nearest.NearestSample",
}


def subclass(name: str, of: str) -> str:
    module, _, base = of.rpartition(".")
    return f"\n\nfrom depthcli.{module} import {base}\nclass {name}({base}):\n    '''Another {base}.'''\n"


@pytest.fixture(autouse=True)
def _forget_plugins():
    """Leave no plug-in behind for other tests."""
    yield
    forget()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE + "".join(subclass(*each) for each in SUBCLASSES.items()))
    return path


@pytest.fixture
def scenes(two_scenes: Path, tmp_path: Path) -> Path:
    """Two scenes, the truth of one of them in the plug-in's format."""
    folder = shutil.copytree(two_scenes, tmp_path / "scenes")
    truth = next(folder.rglob("disp_left.pfm"))
    np.savetxt(truth.with_suffix(".numbers"), read_pfm(truth))
    truth.unlink()
    return folder


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, source: str) -> Path:
    """Make a package that looks installed: a module in it and its metadata."""
    package = folder / name.replace("-", "_")
    laid(package, {"__init__.py": "", "module.py": source, "_private.py": "import nowhere_at_all"})
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n"
    laid(folder, {f"{package.name}-1.2.dist-info/METADATA": metadata})
    monkeypatch.syspath_prepend(str(folder))
    return package


def forget() -> None:
    for module in list(plugins.loaded):
        plugins.forget(module)
    for name in [name for name in sys.modules if name.startswith("strange_")]:
        del sys.modules[name]
    protocols.load.cache_clear()


def test_classes_of_a_file_are_found_by_their_names_and_named_in_mistakes(file: Path):
    load_plugin(str(file))
    load_plugin(str(file))  # again: nothing happens
    greeting = "from depthcli.commands import command\n\n\n@command()\ndef greet() -> int:\n    return 0\n"
    laid(file.parent, {"elsewhere/mine.py": FILE, "other.py": greeting})
    for taken in ("elsewhere/mine.py", "other.py"):
        refused(ConfigError, load_plugin, taken, file.parent)
    assert COSTS.names()[-1] == "wide_census"
    text = "pipeline: local\ncost: {method: Wide-Census, window: [5, 3]}\n"
    config = load_config(StereoConfig, parse_config(text, "x"))
    assert "method: wide_census" in dump_config(config)
    assert load_config(StereoConfig, parse_config(dump_config(config), "x")) == config
    (used,) = used_plugins(config)
    assert used.package == "mine.py" and len(used.version) == 12
    assert [COSTS.find(name) for name in ("wc 5", "ad")] == ["wide_census", "absolute_difference"]
    lacking = {package for package, registry in registries.items() if not registry.added}
    assert not [package for package in lacking if package.startswith("depthcli.")]
    assert versions_here([used]) == {"mine.py": used.version}
    for text in ("cost: wide_censu", "cost: census\nconfidence: [pkrr]", "cost: {method: wide_census, windw: 3}"):
        refused(ConfigError, load_config, StereoConfig, parse_config(f"pipeline: local\n{text}\n", "x"))


def test_a_command_of_a_file(file: Path, tool):
    assert tool.out(0, "greet", "--plugin", file).strip() == "good day"
    assert "Greet the user." in tool.out(0, "--plugin", file, "--help")


@pytest.mark.parametrize("text", [
    "import nowhere_at_all",
    "import sys\nsys.exit(0)",
    "raise BaseException('panic')",
    "x = 1\n1 / 0",
    "def f(:",
    "x = 3",
    None,
    FILE.replace("WideCensus(", "Rank("),
    FILE.replace("def greet", "def stereo"),
    FILE.replace(".numbers", ".png"),  # an ending of ours
    FILE.replace('(".numbers",)', '".numbers"'),
    FILE.replace('(".numbers",)', '("numbers",)'),
])  # fmt: skip
def test_a_file_that_is_no_plugin(text: str | None, tmp_path: Path):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    refused(ConfigError, load_plugin, str(path))
    assert not plugins.loaded
    path.write_text(FILE)
    load_plugin(str(path))  # mended, in the same process
    assert "wide_census" in COSTS.names()


def test_ctrl_c_while_a_plugin_is_imported_is_no_fault_of_it(tmp_path: Path):
    (tmp_path / "mine.py").write_text("raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        load_plugin(str(tmp_path / "mine.py"))


def test_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = subclass("FarCensus", "methods.stereo.cost.census.Census")
    package = install(tmp_path, monkeypatch, "strange-cost", source)
    load_plugin("strange_cost")
    far = COSTS.parse("Far-Census", None)
    assert far.model_dump()["method"] == "far_census"
    assert versions_here(used_plugins(far)) == {"strange-cost": "1.2"}
    assert used_plugins(COSTS.parse("census", None)) == set()
    forget()
    shutil.rmtree(tmp_path / "strange_cost-1.2.dist-info")
    versions = set()
    for text in (source, source + "# changed\n"):  # without a distribution the content counts
        (package / "module.py").write_text(text)
        load_plugin("strange_cost")
        versions |= versions_here(plugins.loaded.values()).items()
        forget()
    assert len(versions) == 2 and {name for name, _ in versions} == {"strange_cost"}


def test_presets_of_packages_and_broken_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool):
    package = install(tmp_path, monkeypatch, "strange-kit", "")
    text = "# Another one.\npipeline: opencv_bm\n"
    names = ("stereo/fast", "stereo/Elas", "nowhere/odd")
    laid(package / "presets", {f"{name}.yaml": text for name in names})
    own = ["--plugin", "strange_kit"]
    assert "stereo Elas " in tool.out(0, "presets", *own)
    fast = package / "presets" / "stereo" / "fast.yaml"
    of_package = [preset[:2] for preset in presets.list_presets() if "strange-kit 1.2" in preset[2]]
    assert of_package == [("nowhere", "odd"), ("stereo", "Elas"), ("stereo", str(fast))]
    assert presets.find_preset("stereo", "fast") == presets.PRESET_FOLDER / "stereo" / "fast.yaml"
    assert presets.find_preset("stereo", "elas") == package / "presets" / "stereo" / "Elas.yaml"
    assert presets.find_config("stereo", str(fast)) == fast
    assert "depthcli stereo Elas ..." in tool.out(0, "presets", "show", "stereo/elas", *own)
    (package / "presets" / "stereo" / "Elas.yaml").write_bytes(b"# \xff\npipeline: local\n")
    tool.told(2, "presets", "show", "elas")
    forget()
    laid(package, {"module.py": "import nowhere_at_all\n"})
    tool.told(2, *own, "--help")
    tool.told(2, "--plugin", "strange_kid", "--help")


@pytest.mark.slow
def test_a_run_records_its_plugins(file: Path, scenes: Path, tmp_path: Path, tool):
    config, out = tmp_path / "c.yaml", tmp_path / "out"
    config.write_text(
        "pipeline: my_pipeline\ncost: wide_census\naggregation: my_window\noptimization: my_winner\n"
        "refinement: [my_median]\nconfidence: [My-Measure]\n"
    )
    run = ["stereo", str(config), "-i", str(scenes), "-o", str(out), "--layout", "my-layout", "--jobs", "2"]
    run += ["--plugin", str(file)]
    assert main([*run, "--evaluate", "-q"]) == 0
    assert read_pfm(next(out.rglob("confidence_my_measure.pfm"))).shape == (64, 96)
    scores = json.loads((out / "evaluation" / "scores.json").read_text())
    assert {result["protocol"] for result in scores["results"]} == {"my-protocol"}
    assert len(scores["plugins"]["mine.py"]) == 12
    assert "\n    mine.py: " in (out / "run.yaml").read_text()
    tool.told(0, *run)
    forget()
    file.write_text(file.read_text() + "# changed\n")
    tool.told(2, *run)


def test_layouts_and_formats_are_recorded_where_they_are_used(file: Path, scenes: Path, tmp_path: Path, tool):
    run = ["stereo", "opencv-bm", "-i", str(scenes), "-q", "--plugin", str(file)]
    assert main([*run, "-o", str(tmp_path / "own")]) == 0
    assert "mine.py" not in (tmp_path / "own" / "run.yaml").read_text()
    run += ["-o", str(tmp_path / "other"), "--layout", "my-layout"]
    tool.told(2, *run, "--scheduler", "tcp://127.0.0.1:9")  # which has no files
    assert main(run) == 0
    assert "\n    mine.py: " in (tmp_path / "other" / "run.yaml").read_text()
    name = next(path.parent.name for path in scenes.rglob("disp_left.pfm"))
    laid(tmp_path, {f"numbers/{name}.numbers": f"{'5 ' * 96}\n" * 64})
    out = tmp_path / "scores"
    of = ["evaluate", str(tmp_path / "numbers"), "--truth", str(scenes), "--scenes", name, "-o", str(out)]
    assert main([*of, "-q", "--plugin", str(file)]) == 0
    assert list(json.loads((out / "scores.json").read_text())["plugins"]) == ["mine.py"]


def test_maps_of_a_format_are_read_everywhere(file: Path, tmp_path: Path):
    load_plugin(str(file))
    path = tmp_path / "a.numbers"
    path.write_text("1.5 nan\n2 inf\n")
    for read in (read_disparity, read_depth):
        np.testing.assert_array_equal(read(path), np.array([[1.5, np.nan], [2, np.nan]], np.float32))
    for text in ("1 2\n3\n", "one"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"a\.numbers: cannot be read as my_text") as caught:
            read_plane(path)
        assert str(caught.value).isprintable()
    forget()
    file.write_text(FILE.replace("ndmin=2)", "ndmin=2)[None]"))
    load_plugin(str(file))
    path.write_text("1 2\n")
    refused(InputError, read_plane, path)


def test_a_config_names_its_plugins(file: Path, tmp_path: Path):
    files = {
        "low.yaml": "plugins: [mine.py]\npipeline: local\ncost: wide_census\n",
        "high.yaml": "plugins: [more.py]\nbase: low\naggregation: cross\n",
        "more.py": subclass("LowCensus", "methods.stereo.cost.census.Census"),
    }
    laid(tmp_path, files)
    config = load_config(StereoConfig, tmp_path / "high.yaml")
    assert config.plugins == ("mine.py", "more.py")
    assert {"wide_census", "low_census"} <= set(COSTS.names())
    laid(tmp_path, {"run/run.yaml": dump_config(config)})
    assert load_config(StereoConfig, tmp_path / "run" / "run.yaml") == config  # the files are in use already
    forget()
    refused(ConfigError, load_config, StereoConfig, tmp_path / "run" / "run.yaml")
    forget()
    text = parse_config("pipeline: local\ncost: wide_census\n", "x")
    assert load_config(StereoConfig, text, ["cost.window=[5,3]", f"plugins=[{file}]"]).plugins == (str(file),)
    (tmp_path / "low.yaml").write_text("plugins: [3]\npipeline: local\n")
    refused(ConfigError, load_config, StereoConfig, tmp_path / "low.yaml")


def test_methods_of_every_command_are_configured(file: Path):
    load_plugin(str(file))
    for command, text in (
        ("stereo", "pipeline: segments\ncost: census\nsegmentation: my_segments\n"),
        ("stereo", "pipeline: segments\ncost: census\nkeypoints: my_keypoints\n"),
        ("refine-kinect", "pipeline: my_fill\n"),
        ("transparent", "pipeline: my_nearest\n"),
        ("register-confidence", "features: [my_feature]\n"),
        ("register-confidence", "pipeline: my_search\n"),
        ("fuse", "measures: [census]\nmaps: {optimizations: [{optimization: scanline}], choice: my_choice}\n"),
    ):
        config = load_config(config_model(command), parse_config(text, "x"))
        assert {plugin.package for plugin in used_plugins(config)} == {"mine.py"}, text


def test_a_file_of_a_family_holds_one_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    head = "from strange_family import Base\n"
    base = "from depthcli.core.method import Method\nclass Base(Method): ...\n"
    both = f"{head}class A(Base): ...\nclass B(Base): ...\n"
    laid(tmp_path / "strange_family", {"__init__.py": base, "both.py": both, "none.py": head})
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.import_module("strange_family")
    family = Family("strange_family")
    refused(TypeError, family.load, "both")
    refused(TypeError, family.load, "none")
    del registries["strange_family"]


BAD = """
import numpy as np

from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.volume import CostVolume


class {}(AbsoluteDifference):
    def __call__(self, pair, n_disparities):
        costs = super().__call__(pair, n_disparities).costs.astype(np.float32)
        costs[20, 30, 0] = wrong(costs)
        return CostVolume(costs)


def wrong(costs):
    {}
"""


@pytest.mark.parametrize(("name", "wrong", "words"), [
    ("one_nan", "return np.nan", ("cost one_nan", "NaN")),
    ("one_infinite", "return np.inf", ("cost one_infinite", "infinite")),
    ("exits", "raise SystemExit(0)", ("plug-in bad.py", "SystemExit")),
    ("panics", "raise BaseException('no exception, as in Rust')", ("plug-in bad.py", "BaseException")),
    ("fails", "return costs['no such key']", ("plug-in bad.py", "(bad.py:16)", "IndexError")),
])  # fmt: skip
@pytest.mark.parametrize("command", [
    ["stereo", "accurate", "--set", "refinement=[]", "--set", "cost={0}"],
    ["stereo", "accurate", "--set", "refinement=[]", "--set", "cost.parts=[{{cost: {0}, lambda: 5}}]"],
    ["fuse", "consensus", "--set", "measures=[{0}]"],
])  # fmt: skip
def test_faults_of_a_cost_are_the_plugin_s(
    name: str, wrong: str, words: tuple[str, ...], command: list[str], scenes: Path, tmp_path: Path
):
    (tmp_path / "bad.py").write_text(BAD.format(name.title().replace("_", ""), wrong))
    run = [*(word.format(name) for word in command), "--plugin", str(tmp_path / "bad.py")]
    assert main([*run, "-i", str(scenes), "-o", str(tmp_path / "run"), "-q"]) == 3
    for row in rows(tmp_path / "run").values():
        assert row["status"] == "failed" and all(word in row["error"] for word in words), row["error"]
        assert "a bug in" not in row["error"]


def test_a_layout_that_exits_is_no_success(scenes: Path, tmp_path: Path, tool):
    bad = "from depthcli.io.scenes import Layout, StereoScene\n\n\nclass MyLayout(Layout):\n    about = 'x'\n"
    bad += "    kind = StereoScene\n\n    def scenes(self, folder):\n        raise SystemExit(0)\n"
    (tmp_path / "bad.py").write_text(bad)
    run = ["stereo", "opencv-bm", "--plugin", str(tmp_path / "bad.py"), "--layout", "my-layout", "-i", str(scenes)]
    tool.told(2, *run, "-o", tmp_path / "run")
