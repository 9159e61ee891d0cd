"""A config over another; names in any case and abbreviated; one method a file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import ClassVar

import pytest

from depthcli.core import registry
from depthcli.core.config_file import dump_config, load_config
from depthcli.core.errors import ConfigError
from depthcli.core.method import Family, RootConfig
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.stereo.config import StereoConfig
from depthcli.methods.stereo.pipeline import Pipeline


def write(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)


def test_a_config_is_laid_over_its_base(tmp_path: Path):
    write(
        tmp_path,
        low="pipeline: local\ncost: {method: census, window: [5, 5]}\noptimization: {method: scanline, p1: 0.7}\n",
        middle="base: low\nrefinement: [median]\noptimization: {p2: 3.0}\n",
        top="base: middle.yaml\ncost: rank\n",
    )
    config = load_config(StereoConfig, tmp_path / "top.yaml")
    dumped = config.model_dump(mode="json")
    assert dumped["cost"]["method"] == "rank"  # another method brings nothing of the base's parameters
    assert (dumped["optimization"]["p1"], dumped["optimization"]["p2"]) == (0.7, 3.0)
    assert [step["method"] for step in dumped["refinement"]] == ["median"]
    assert "base" not in dump_config(config)


def test_mistakes_are_told_where_they_stand(tmp_path: Path):
    write(
        tmp_path, one="base: two\n", two="base: one\n", none="base: nowhere\n", odd="base: [1]\n",
        wrong="pipeline: local\ncost: {method: census, windw: 3}\n", over="base: wrong\naggregation: cros\n",
    )  # fmt: skip
    for name, said in (
        ("one", r"two\.yaml:1: base: one leads back to this file"),
        ("none", r"none\.yaml:1: base: \"nowhere\" is neither a preset nor a file beside this one"),
        ("odd", r"odd\.yaml:1: base: want the name of a preset or a file \(got \[1\]\)"),
        ("over", r"wrong\.yaml:2: cost\.windw: no such key .*did you mean 'window'"),
        ("over", r"over\.yaml:2: aggregation: no method called 'cros'; did you mean 'cross'"),
    ):
        with pytest.raises(ConfigError, match=said):
            load_config(StereoConfig, tmp_path / f"{name}.yaml")
    write(tmp_path, low="pipeline: opencv_bm\n")
    found = load_config(StereoConfig, tmp_path / "none.yaml", find=lambda name: tmp_path / "low.yaml")
    assert found.pipeline.method_name() == "opencv_bm"


def test_the_field_s_abbreviations_are_names(tmp_path: Path):
    write(tmp_path, a="pipeline: LOCAL\ncost: AD\naggregation: cw\noptimization: {method: SGM}\n"
          "refinement: [LRC, Median]\nconfidence: [PKR, Lrc]\n")  # fmt: skip
    dumped = load_config(StereoConfig, tmp_path / "a.yaml").model_dump(mode="json")
    names = [dumped[key]["method"] for key in ("cost", "aggregation", "optimization")]
    assert names == ["absolute_difference", "constant_window", "scanline"]
    assert [step["method"] for step in dumped["refinement"]] == ["left_right_check", "median"]
    assert dumped["confidence"] == ["pkr", "lrc"]


def test_nested_typos_get_their_hint(tmp_path: Path):
    write(tmp_path, s="pipeline: segments\ncost: census\nkeypoints: {method: SURF, treshold: 1}\n",
          f="measures: [{method: census, windw: [5, 5]}]\n")  # fmt: skip
    with pytest.raises(ConfigError, match=r"s\.yaml:3: keypoints\.treshold: .*did you mean 'threshold'"):
        load_config(StereoConfig, tmp_path / "s.yaml")
    with pytest.raises(ConfigError, match=r"f\.yaml:1: measures\.0\.windw: .*did you mean 'window'"):
        load_config(FuseConfig, tmp_path / "f.yaml")


def test_options_are_blamed_by_their_name(tmp_path: Path):
    write(tmp_path, c="pipeline: opencv_bm\n", f="measures: [{cost: census}]\n")
    with pytest.raises(ConfigError, match=r"^--max-disparity: should be"):
        load_config(StereoConfig, tmp_path / "c.yaml", [("--max-disparity", "max_disparity=0")])
    with pytest.raises(ConfigError, match=r"^--set measures\.0\.volume: .*either cost or volume"):
        load_config(FuseConfig, tmp_path / "f.yaml", ["measures.0.volume=x.npy"])
    for text in ("9" * 6000, "1e305", "[" * 300):
        with pytest.raises(ConfigError, match="--set max_disparity"):
            load_config(StereoConfig, tmp_path / "c.yaml", [f"max_disparity={text}"])


def test_a_file_holds_one_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "family").mkdir()
    (tmp_path / "family" / "__init__.py").write_text("")
    method = "class {}(Method):\n    def __call__(self):\n        return 1\n"
    head = "from depthcli.core.method import Method\n"
    (tmp_path / "family" / "both.py").write_text(head + method.format("A") + method.format("B"))
    (tmp_path / "family" / "none.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "_registries", dict(registry._registries))  # the family is no one else's
    family = Family("family")
    with pytest.raises(TypeError, match=r"family\.both defines A and B; a file of a family holds one method"):
        family.load("both")
    with pytest.raises(TypeError, match="defines no method"):
        family.load("none")
    sys.modules.pop("family", None)


class _Root(RootConfig):
    flattened: ClassVar[str] = "pipeline"
    pipeline: Pipeline


def test_names_are_canonical_in_the_dump():
    assert _Root.model_validate({"pipeline": "SGBM"}).model_dump()["pipeline"] == "opencv_sgbm"
