"""Plug-ins: objects of installed packages and of files, beside our own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from depthcli.cli import main
from depthcli.core import plugins, registry
from depthcli.core.config_file import dump_config, load_config, parse_config
from depthcli.core.errors import ConfigError
from depthcli.core.method import Family, used_plugins
from depthcli.io import layouts
from depthcli.io.walk import discover_scenes
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run import presets

pytestmark = pytest.mark.usefixtures("forget_plugins")
COSTS = Family.of("depthcli.methods.stereo.cost")

FILE = '''
from pathlib import Path

from pydantic import Field

from depthcli.run.command import Command
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes.stereo import StereoScene
from depthcli.evaluation.protocols.eth3d import Eth3dProtocol
from depthcli.methods.stereo.cost.census import Census


class WideCensus(Census):
    """A census whose window is wide."""

    window: tuple[int, int] = Field(default=(11, 3), description="Columns and rows.")


class TopBottom(Layout):
    kind = StereoScene
    wants = "top.png, bottom.png"

    def scenes(self, folder: Folder) -> list:
        if not folder.has("top.png", "bottom.png"):
            return []
        return [self.scene(folder, left=folder.path / "top.png", right=folder.path / "bottom.png")]


class Strict(Eth3dProtocol):
    """ETH3D's protocol under another name."""


class Greet(Command):
    """Greet the user."""

    def run(self, values, reporter):
        reporter.data("good day")
        return 0


class _Hidden(Census):
    """Not registered."""
'''


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, entries: str, source: str) -> None:
    """Make a package that looks installed: a module and its metadata."""
    (folder / f"{name.replace('-', '_')}.py").write_text(source)
    info = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(str(folder))
    plugins._installed.cache_clear()
    plugins._is_any_installed.cache_clear()


def test_classes_of_a_file_are_found_by_their_names(file: Path, tmp_path: Path):
    plugins.load_file(file)
    plugins.load_file(file)  # again: nothing happens
    assert COSTS.names()[-1] == "wide_census"
    config = load_config(
        StereoConfig, parse_config("pipeline: local\ncost: {method: Wide-Census, window: [5, 3]}\n", "x")
    )
    text = dump_config(config)
    assert "method: wide_census" in text
    assert load_config(StereoConfig, parse_config(text, "x")) == config
    (used,) = used_plugins(config)
    assert used.package == "mine.py" and len(used.version) == 12
    (tmp_path / "scene").mkdir()
    for name in ("top.png", "bottom.png"):
        (tmp_path / "scene" / name).touch()
    (scene,) = discover_scenes(tmp_path / "scene")
    assert scene.layout == "top-bottom"
    assert discover_scenes(tmp_path / "scene", layout="Top_Bottom") == [scene]


def test_a_mistake_names_the_plugin_s_keys_and_methods(file: Path):
    plugins.load_file(file)
    for text, said in (
        ("cost: wide_censu", r"no method called 'wide_censu'; did you mean 'wide_census'.* wide_census \(mine\.py\)"),
        ("cost: census\nconfidence: [pkrr]", r"no confidence measure called 'pkrr'; did you mean 'pkrn?'\?; one of: "),
        ("cost: {method: wide_census, windw: 3}", r"cost\.windw: no such key .*did you mean 'window'"),
    ):
        with pytest.raises(ConfigError, match=said):
            load_config(StereoConfig, parse_config(f"pipeline: local\n{text}\n", "x"))


def test_a_command_of_a_file(file: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["greet", "--plugin", str(file)]) == 0
    assert capsys.readouterr().out.strip() == "good day"
    assert main(["--plugin", str(file), "--help"]) == 0
    assert "Greet the user." in capsys.readouterr().out
    assert main(["greet", "--help"]) == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import nowhere_at_all", r"mine\.py:1: plug-in cannot be loaded: ModuleNotFoundError"),
        ("x = 1\n1 / 0", r"mine\.py:2: plug-in cannot be loaded: ZeroDivisionError: division by zero"),
        ("def f(:", r"mine\.py.*plug-in cannot be loaded: SyntaxError"),
        ("x = 3", r"mine\.py: holds no method, layout"),
    ],
)
def test_a_file_that_is_no_plugin(text: str, said: str, tmp_path: Path):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        plugins.load_file(path)
    assert not os.environ["DEPTHCLI_PLUGIN_FILES"]
    path.write_text(FILE)
    plugins.load_file(path)  # mended, in the same process
    assert "wide_census" in COSTS.names()


def test_a_file_that_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["presets", "--plugin", str(tmp_path / "none.py")]) == 2
    assert "none.py: plug-in cannot be read" in capsys.readouterr().err


def test_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = "from depthcli.methods.stereo.cost.census import Census\nclass Far(Census):\n    '''Far.'''\n"
    entries = "[depthcli.stereo.cost]\nfar-census = strange_cost:Far\ncensus = strange_cost:Far2\n"
    install(tmp_path, monkeypatch, "strange-cost", entries, source + "class Far2(Census):\n    '''Another.'''\n")
    assert set(COSTS.names()) >= {"census", "far_census", "strange-cost:census"}
    assert COSTS.parse("far_census").model_dump()["method"] == "far_census"
    assert type(COSTS.parse("census")).__module__.startswith("depthcli.")
    other = COSTS.parse("strange-cost:census")
    assert type(other).__name__ == "Far2" and other.model_dump()["method"] == "strange-cost:census"
    assert registry.versions_here(used_plugins(other)) == {"strange-cost": "1.2"}
    assert used_plugins(COSTS.parse("census")) == set()


def test_aliases_of_plugins_are_names_after_ours(file: Path):
    file.write_text(FILE.replace('wide."""', 'wide."""\n\n    aliases = ("AD", "WC-5")'))
    plugins.load_file(file)
    assert COSTS.find("wc 5") == "wide_census"
    assert COSTS.find("ad") == "absolute_difference"
    assert COSTS.find("mine.py:wc-5") is None


def test_a_broken_package_costs_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    entries = "[depthcli.stereo.cost]\nfar = strange_broken:Far\n[depthcli.layouts]\nodd = strange_broken:Odd\n"
    install(tmp_path, monkeypatch, "strange-broken", entries, "import nowhere_at_all\n")
    with pytest.warns(plugins.PluginWarning, match=r"far of strange-broken 1\.2 cannot be loaded: ModuleNotFound"):
        assert "far" not in COSTS.names()
    with pytest.raises(ConfigError, match="far of strange-broken"):
        COSTS.parse("far")
    with pytest.warns(plugins.PluginWarning, match="odd of strange-broken"):
        assert layouts.layouts() == layouts.own_layouts()


@pytest.mark.filterwarnings("always::depthcli.core.plugins.PluginWarning")
def test_a_broken_command_is_left_out_of_the_help(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    entries = "[depthcli.commands]\nbow = strange_command:Bow\n"
    install(tmp_path, monkeypatch, "strange-command", entries, "import nowhere\n")
    assert main(["--help"]) == 0
    out, err = capsys.readouterr()
    assert "refine-kinect" in out and "bow" not in out
    assert "warning: plug-in bow of strange-command 1.2 cannot be loaded: ModuleNotFoundError" in err
    assert main(["bow"]) == 2
    assert "bow of strange-command 1.2 cannot be loaded" in capsys.readouterr().err


def test_presets_of_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    for command, name in (("stereo", "fast"), ("stereo", "elas"), ("nowhere", "odd")):
        file = tmp_path / "strange_kit" / "mine" / command / f"{name}.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("# Another one.\npipeline: opencv_bm\n")
    install(tmp_path, monkeypatch, "strange-kit", "[depthcli.presets]\nx = strange_kit:mine\n", "")
    (tmp_path / "strange_kit.py").rename(tmp_path / "strange_kit" / "__init__.py")
    of_package = [preset[:2] for preset in presets.list_presets() if "strange-kit 1.2" in preset[2]]
    assert of_package == [("nowhere", "odd"), ("stereo", "elas"), ("stereo", "strange-kit:fast")]
    assert presets.find_preset("stereo", "fast") == presets.preset_folder() / "stereo" / "fast.yaml"
    for name in ("Elas", "strange-kit:elas", "Strange_Kit:fast"):
        found = presets.find_preset("stereo", name)
        assert found is not None and found.is_relative_to(tmp_path) and presets.preset_of("stereo", name) == ""
    assert main(["presets"]) == 0
    assert "stereo elas " in capsys.readouterr().out
    assert main(["presets", "show", "stereo/elas"]) == 0
    assert "depthcli stereo elas ..." in capsys.readouterr().out
    (tmp_path / "strange_kit" / "mine" / "stereo" / "elas.yaml").write_bytes(b"# \xff\npipeline: local\n")
    assert main(["presets", "show", "elas"]) == 2
    assert "elas.yaml:1: not UTF-8 text" in capsys.readouterr().err
    assert main(["presets", "show", "odd"]) == 2
    assert "odd.yaml: no command called 'nowhere' that has configs" in capsys.readouterr().err


def test_a_package_without_its_presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    entries = "[depthcli.presets]\nx = strange_none:mine\ny = nowhere_at_all.a:mine\n"
    install(tmp_path, monkeypatch, "strange-none", entries, "")
    with pytest.warns(plugins.PluginWarning, match=r"strange-none 1\.2: no COMMAND/NAME\.yaml in \w"):
        assert presets.find_preset("stereo", "fast") is not None


def test_an_object_of_another_kind_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    install(tmp_path, monkeypatch, "strange-int", "[depthcli.layouts]\nodd = strange_int:x\n", "x = 3\n")
    with pytest.warns(plugins.PluginWarning, match="want a class derived from depthcli.io.layouts.Layout, got 3"):
        layouts.layouts()


def test_a_run_records_its_plugins(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    config = tmp_path / "c.yaml"
    config.write_text("pipeline: local\ncost: wide_census\n")
    scenes, out = tmp_path / "scenes", tmp_path / "out"
    assert (
        main(["sample", "-n", "2", "-o", str(scenes), "--width", "64", "--height", "48", "--max-disparity", "16", "-q"])
        == 0
    )
    run = ["stereo", str(config), "-i", str(scenes), "-o", str(out), "--plugin", str(file), "-q", "--jobs", "2"]
    assert main(run) == 0
    assert "\n    mine.py: " in (out / "run.yaml").read_text()
    plugins.load_file(file)
    for known in (plugins._file_plugins, plugins._read_files, registry._plugin_by_class):
        known.clear()
    del sys.modules["depthcli_plugin_mine"]
    file.write_text(FILE + "# changed\n")
    assert main(run) == 2
    assert "another config (it says 'mine.py: " in capsys.readouterr().err


def test_a_config_names_its_plugins(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "low.yaml").write_text("plugins: [mine.py]\npipeline: local\ncost: wide_census\n")
    (tmp_path / "high.yaml").write_text("plugins: [more.py]\nbase: low\naggregation: cross\n")
    (tmp_path / "more.py").write_text(FILE.replace("WideCensus", "LowCensus").replace("Greet", "Farewell"))
    config = load_config(StereoConfig, tmp_path / "high.yaml")
    assert config.plugins == ("mine.py", "more.py")
    assert {"wide_census", "low_census"} <= set(COSTS.names())
    text = dump_config(config)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.yaml").write_text(text)
    assert load_config(StereoConfig, tmp_path / "run" / "run.yaml") == config  # the files are in use already
    for known in (plugins._file_plugins, plugins._read_files, registry._plugin_by_class):
        known.clear()
    with pytest.raises(ConfigError, match=r"run\.yaml:\d+: plugins: mine\.py is no file in .*; --plugin FILE"):
        load_config(StereoConfig, tmp_path / "run" / "run.yaml")
    (tmp_path / "low.yaml").write_text("plugins: [3]\npipeline: local\n")
    with pytest.raises(ConfigError, match=r"low\.yaml:1: plugins: want the name of a Python file \(got 3\)"):
        load_config(StereoConfig, tmp_path / "low.yaml")


def test_the_config_of_a_run_names_packages_that_are_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    config = tmp_path / "run.yaml"
    config.write_text(
        "pipeline: local\ncost: far\nrun:\n  versions:\n    python: 3.11.7\n    numpy: 1.0\n    strange-cost: '1.2'\n"
        "    mine.py: 0123456789ab\n"
    )
    assert main(["stereo", str(config), "-i", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert [line.partition("run.yaml:")[2] for line in said if "made with" in line] == [
        "7: run.versions.strange-cost: the run was made with strange-cost 1.2, which is not installed",
        "8: run.versions.mine.py: the run was made with mine.py 0123456789ab, which is not loaded; --plugin FILE.py "
        "says where it is",
    ]
    assert len(said) == 3 and "no method called 'far'" in said[0]
