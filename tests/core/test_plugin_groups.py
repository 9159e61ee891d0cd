"""One plug-in file that adds to every group, used by the commands, and what is recorded of it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.commands import config_model
from depthcli.core import registry
from depthcli.core.config_file import load_config, parse_config
from depthcli.core.errors import InputError
from depthcli.core.method import Family, used_plugins
from depthcli.core.plugins import load_file
from depthcli.core.registry import groups
from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_disparity, read_pfm, read_plane, write_pfm
from depthcli.io.formats.map_format import map_suffixes

pytestmark = [pytest.mark.usefixtures("forget_plugins"), pytest.mark.slow]

FILE = '''
from dataclasses import replace

import numpy as np

from depthcli.algorithms.keypoints.surf import Surf
from depthcli.algorithms.segmentation.slic import Slic
from depthcli.io.formats.map_format import MapFormat
from depthcli.simulate.samples.stereo import StereoSample
from depthcli.io.layouts import Folder
from depthcli.io.layouts.scenes import Scenes
from depthcli.evaluation.protocols.eth3d import Eth3dProtocol
from depthcli.methods.confidence import ConfidenceMeasure
from depthcli.methods.fusion.choice.energy import LeastEnergyChoice
from depthcli.methods.kinect.pipeline.nearest import NearestFill
from depthcli.methods.registration.feature.intensity import Intensity
from depthcli.methods.registration.pipeline.search import RegistrationSearch
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.transparent.pipeline.nearest import NearestSample


class MyText(MapFormat):
    suffixes = (".numbers",)

    def read(self, path):
        return np.loadtxt(path, ndmin=2)


class MyLayout(Scenes):
    """Our own layout, where a file says so."""

    def scenes(self, folder: Folder):
        if folder.requested != self.name:
            return []
        return [replace(scene, protocol="my_protocol") for scene in super().scenes(folder)]


class MyMeasure(ConfidenceMeasure):
    """Spread of the costs."""

    def __call__(self, curves):
        return curves.costs.max(axis=-1).astype("float32") - curves.statistics.lowest


class MyProtocol(Eth3dProtocol):
    """ETH3D's under another name."""


class MySample(StereoSample):
    about = "Stereo scenes of our own."
'''
SUBCLASSES = {
    "MyKeypoints": "Surf", "MySegments": "Slic", "MyChoice": "LeastEnergyChoice", "MyFill": "NearestFill",
    "MyFeature": "Intensity", "MyWindow": "ConstantWindow", "MyWinner": "WinnerTakesAll", "MyPipeline": "Local",
    "MyMedian": "Median", "MyNearest": "NearestSample", "MySearch": "RegistrationSearch",
}  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    classes = (f"\n\nclass {name}({base}):\n    '''Another {base}.'''\n" for name, base in SUBCLASSES.items())
    path.write_text(FILE + "".join(classes))
    return path


@pytest.fixture
def scenes(tmp_path: Path, file: Path) -> Path:
    """Two scenes, the truth of one of them in the plug-in's format."""
    folder = tmp_path / "scenes"
    size = ["--width", "64", "--height", "48", "--max-disparity", "12", "-q"]
    assert main(["sample", "--my-sample", "-n", "2", "-o", str(folder), *size, "--plugin", str(file)]) == 0
    truth = next(folder.rglob("disp_left.pfm"))
    np.savetxt(truth.with_suffix(".numbers"), read_pfm(truth))
    truth.unlink()
    return folder


def test_every_group_has_a_plug_in(file: Path):
    load_file(file)
    with_plugins = {each.group for each in registry._registries.values() if each.plugins()}
    ours = {group for group in groups() if group.startswith("depthcli.")}  # other tests make groups of their own
    assert ours - with_plugins <= {"depthcli.commands", "depthcli.stereo.cost", "depthcli.kinect.model"}


def test_maps_of_a_format_are_read_everywhere(file: Path, tmp_path: Path):
    load_file(file)
    path = tmp_path / "a.numbers"
    path.write_text("1.5 nan\n2 inf\n")
    np.testing.assert_array_equal(read_disparity(path), np.array([[1.5, np.nan], [2, np.nan]], np.float32))
    np.testing.assert_array_equal(read_depth(path), np.array([[1.5, np.nan], [2, np.nan]], np.float32))
    assert read_plane(path).shape == (2, 2)
    for text, said in (("1 2\n3\n", "cannot be read as my_text: "), ("one", "cannot be read as my_text")):
        path.write_text(text)
        with pytest.raises(InputError, match=rf"a\.numbers: {said}"):
            read_plane(path)
    with pytest.raises(InputError, match=r"none\.numbers: "):
        read_plane(tmp_path / "none.numbers")


def test_a_format_cannot_take_an_ending_of_ours(tmp_path: Path):
    path = tmp_path / "bad.py"
    path.write_text(FILE.replace(".numbers", ".png"))
    load_file(path)
    with pytest.warns(UserWarning, match=r"my_text of bad\.py .*\.png is read by depthcli itself"):
        assert ".numbers" not in map_suffixes()


def test_a_run_of_all_of_it(file: Path, scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    config, out = tmp_path / "c.yaml", tmp_path / "out"
    config.write_text(
        "pipeline: my_pipeline\ncost: census\naggregation: my_window\noptimization: my_winner\n"
        "refinement: [my_median]\nconfidence: [My-Measure]\n"
    )
    plugin = ["--plugin", str(file)]
    run = ["stereo", str(config), "-i", str(scenes), "-o", str(out), "--layout", "my-layout", "--jobs", "2", *plugin]
    assert main([*run, "--evaluate", "-q"]) == 0
    assert read_pfm(next(out.rglob("confidence_my_measure.pfm"))).shape == (48, 64)
    scores = json.loads((out / "evaluation" / "scores.json").read_text())
    assert {result["protocol"] for result in scores["results"]} == {"my-protocol"}
    assert len(scores["plugins"]["mine.py"]) == 12
    assert "Plug-ins: `mine.py " in (out / "evaluation" / "report.md").read_text()
    capsys.readouterr()
    assert main([*run]) == 0
    assert "2 of 2 scenes are done already" in capsys.readouterr().err


def test_an_evaluation_records_the_format_of_a_run_s_maps(file: Path, made_scenes: Path, tmp_path: Path):
    size = read_pfm(made_scenes / "planes_0" / "disp_left.pfm").shape
    for ending in ("pfm", "numbers"):
        (tmp_path / ending).mkdir()
    write_pfm(tmp_path / "pfm" / "planes_0.pfm", np.full(size, 5, np.float32))
    np.savetxt(tmp_path / "numbers" / "planes_0.numbers", np.full(size, 5))
    for ending, used in (("pfm", []), ("numbers", ["mine.py"])):
        out = tmp_path / f"of_{ending}"
        run = ["evaluate", str(tmp_path / ending), "--truth", str(made_scenes), "--scenes", "planes_0", "-o", str(out)]
        assert main([*run, "-q", "--plugin", str(file)]) == 0
        assert list(json.loads((out / "scores.json").read_text())["plugins"]) == used


def test_a_layout_alone_is_recorded(file: Path, scenes: Path, tmp_path: Path):
    run = ["stereo", "opencv-bm", "-i", str(scenes), "-q", "--plugin", str(file)]
    assert main([*run, "-o", str(tmp_path / "own")]) == 0
    assert "mine.py" not in (tmp_path / "own" / "run.yaml").read_text()
    assert main([*run, "-o", str(tmp_path / "other"), "--layout", "my-layout"]) == 0
    assert "\n    mine.py: " in (tmp_path / "other" / "run.yaml").read_text()


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("stereo", "pipeline: segments\ncost: census\nsegmentation: my_segments\n"),
        ("refine-kinect", "pipeline: my_fill\n"),
        ("transparent", "pipeline: my_nearest\n"),
        ("register-confidence", "features: [my_feature]\n"),
        ("register-confidence", "pipeline: my_search\n"),
        ("fuse", "measures: [census]\nmaps: {segmentations: [{segmentation: slic}], choice: my_choice}\n"),
        ("stereo", "pipeline: segments\ncost: census\nkeypoints: my_keypoints\n"),
    ],
)
def test_methods_of_every_command_are_configured(file: Path, command: str, text: str):
    load_file(file)
    model = config_model(command)
    assert model is not None
    config = load_config(model, parse_config(text, "x"))
    assert {plugin.package for plugin in used_plugins(config)} == {"mine.py"}
    assert {plugin.name for plugin in used_plugins(config)} == {re.search("my_[a-z]+", text)[0]}


def test_a_process_without_the_plug_in_says_so(file: Path):
    load_file(file)
    (plugin, *_) = Family.of("depthcli.methods.confidence").plugins().values()
    assert registry.versions_here([plugin]) == {"mine.py": plugin.version}
    absent = replace(plugin, package="elsewhere")
    assert registry.versions_here([plugin, absent]) == {"elsewhere": "missing", "mine.py": plugin.version}


def test_a_scheduler_refuses_files(file: Path, scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = ["stereo", "opencv-bm", "-i", str(scenes), "-o", str(tmp_path / "o"), "--plugin", str(file), "-q"]
    assert main([*run, "--layout", "my-layout", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "--scheduler: mine.py: workers have no plug-in files; install it as a package" in capsys.readouterr().err
