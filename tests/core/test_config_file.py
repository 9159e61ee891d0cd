"""Configs: where each mistake stands, ``--set``, a config over another one, the text of a resolved one, bounds."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from depthcli.core.config_file import dump_config, find_config, load_config
from depthcli.core.errors import ConfigError
from depthcli.core.method import Family, RootConfig
from depthcli.core.yaml_source import parse_config, read_config, to_yaml
from depthcli.problems.fusion import FuseConfig
from depthcli.problems.stereo import StereoConfig
from tests.core.toys import AnyToy
from tests.core.toys.box import Box
from tests.golden import refused, saying


class Root(RootConfig):
    flattened: ClassVar[str] = "toy"
    renamed: ClassVar[dict[str, str]] = {"upper": "top"}
    toy: AnyToy
    top: int | None = Field(None, ge=1)


def load(text: str, *settings: str) -> Root:
    return load_config(Root, parse_config(text, "f.yaml"), settings)


def write(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)


def test_a_method_is_a_name_or_a_mapping_and_its_fields_stand_at_the_root():
    root = load("toy: box\nsize: [7, 9]\ntop: 4\n")
    assert (root.top, root.toy.size) == (4, (7, 9))
    assert load("toy: chest\ncost: census\n") == load("toy: chest\ncost: {method: census}\n")
    assert load("toy: chest\ncost: {method: census, window: [5, 5]}").toy.cost.window == (5, 5)
    refused(TypeError, Family.of, "depthcli.io")  # which has no methods


def test_symbols_are_other_names_of_keys_for_options(tmp_path: Path):
    write(tmp_path, a="toy: box\nsize: [7, 9]\nsymbols: {T: top, H: size.1}\n", b="base: a\nsymbols: {T: size.0}\n")
    root = load_config(Root, tmp_path / "a.yaml", ["T=4", "H=3"])
    assert (root.top, root.toy.size) == (4, (7, 3))
    root = load_config(Root, tmp_path / "b.yaml", ["T=4", "H=3"])
    assert (root.top, root.toy.size) == (None, (4, 3))
    assert "symbols" not in dump_config(root)
    refused(ConfigError, load_config, Root, tmp_path / "a.yaml", ["T=x"])


CHEST = "toy: chest\ncost: census\nparts: [rank]\nwidth: 1\n"
MISTAKES = (
    ("toy: chest\ncost: {method: census, windw: [9, 7]}\nwidht: 3\ntop: 0\nparts:\n  - census\n  - censsus\n"
     "  - method: rank\n    window: [3, x]\nupper: 3\ntopp: 2\n",),
    ("toy: box\nsize: [7, 9]\nsymbols: [T]\n",),
    ("toy: bx\n",), ("toy: 3\n",), ("toy: chest\ncost: 3\n",),
    ("toy: chest\n",),
    ("toy: box\nweight: .nan\nsize: [1, 2, 3]\n",),
    ("toy: box\ntoy: box\n",),
    ("toy: box\n\tsize: [1, 2]\n",),
    ("# only a comment\n",),
    ("toy: *box\n",),
    ("toy: " + "[" * 5000,),
    ("a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [{f'*a{n - 1}, ' * 9}]\n" for n in range(1, 9)),),
    ("toy: !!python/name:os.system x\n",),
    ("? [a]\n: b\n",),
    ("toy: box\n--- \ntoy: box\n",),
    ("toy: \x00\n",),
    # Truth values and the octal and sexagesimal numbers of YAML 1.1 are no numbers.
    ("toy: box\ntop: yes\nsize: [7, true]\n",),
    ("toy: box\n\ntop: 010\n",),
    ("toy: box\ntop: 1:30\n",),
    ("toy: box\n", "heft=2", "top=true"),
    ("toy: box\n", "top=1:30.5"),
    *((CHEST, setting) for setting in
      ("parts.1=census", "width.x=3", "width", "=3", "widht=3", "cost.window=[9", "top=0")),
)  # fmt: skip


def test_every_mistake_is_told_with_its_line():
    for text, *settings in MISTAKES:
        with saying(ConfigError):
            load(text, *settings)


@pytest.mark.parametrize("data", [b"toy: \xff\xfe", b"x" * (1 << 21), None])
def test_files_that_are_no_text(data: bytes | None, tmp_path: Path):
    file = tmp_path / "c.yaml"
    if data is None:
        os.mkfifo(tmp_path / "pipe.yaml")  # at which reading would hang
        refused(ConfigError, read_config, tmp_path / "pipe.yaml")
    else:
        file.write_bytes(data)
    refused(ConfigError, read_config, file)


@pytest.mark.parametrize(("config", "said"), [
    ("x" * 5000 + ".yaml", "xx: "), ("sensor", "; transparent has one of that name"),
    ("nearest", "; refine-kinect and transparent have one of that name"), ("acurate", "did you mean 'accurate'"),
])  # fmt: skip
def test_presets_of_other_commands_are_named(config: str, said: str):
    with pytest.raises(ConfigError) as caught:
        find_config("stereo", config)
    assert said in str(caught.value)


def test_anchors_merge_keys_and_numbers_without_a_dot():
    root = load("toy: chest\ncost: &c {method: census, window: [5, 5]}\nparts: [{<<: *c, window: [3, 3]}, *c]\n")
    assert [part.window for part in root.toy.parts] == [(3, 3), (5, 5)]
    box = load("toy: box\nweight: 1e-3\ntop: 0x10\n")
    assert (box.toy.weight, box.top) == (1e-3, 16)


def test_set_overrides_what_the_file_says():
    text = "toy: chest\ncost: census\nparts: [rank, census]\n"
    root = load(text, "cost.window=[5,5]", "parts.0.window=[7, 7]", "parts.1=gradient", "width=1", "width=2", "mode=~")
    assert root.toy.cost.window == (5, 5)
    assert root.toy.parts[0].window == (7, 7)
    assert root.toy.parts[1].method_name() == "gradient"
    assert (root.toy.width, root.toy.mode) == (2, None)
    assert load("toy: box\n", "size.1=9").toy.size == (3, 9)  # below a default


def test_options_are_blamed_by_their_name(tmp_path: Path):
    write(tmp_path, c="pipeline: opencv_bm\n", f="measures: [{cost: census}]\n")
    settings = [[f"max_disparity={text}"] for text in ("9" * 6000, "0x" + "f" * 6000, "1e305", "[" * 300)]
    for setting in ([("--max-disparity", "max_disparity=0")], *settings):
        with saying(ConfigError):
            load_config(StereoConfig, tmp_path / "c.yaml", setting)
    for values in ({"max_disparity": 0}, {"block": 6}):  # a block has a center
        with saying(ConfigError):
            load_config(StereoConfig, tmp_path / "c.yaml", values=values)
    with saying(ConfigError):
        load_config(FuseConfig, tmp_path / "f.yaml", ["measures.0.volume=x.npy"])


def test_dump_reads_back_and_is_stable():
    root = load("toy: chest\ncost: census\nparts: [rank, {method: absolute_difference}]\n")
    text = dump_config(root)
    assert load(text) == root and dump_config(load(text)) == text
    assert load(dump_config(load("toy: box\n"))).toy.weight == 1e-6
    box = Box(size=(1, 2))
    assert Root(toy=box).toy == box and Root(toy=box) == load("toy: box\nsize: [1, 2]\n")
    assert to_yaml([math.inf, -math.inf, math.nan, 1e-5]) == "[.inf, -.inf, .nan, 1.0e-05]\n"
    assert dump_config(load("toy: box\nrun: {versions: {numpy: '2.0'}}\n")) == dump_config(load("toy: box\n"))


@pytest.mark.slow
@given(st.text(max_size=60) | st.text(alphabet="ab:-[]{}&*!|>'\"#%@,? \n\t01.~", max_size=40))
def test_any_text_is_a_config_or_a_config_error(text: str):
    try:
        load(text)
    except ConfigError as error:
        assert str(error).startswith("f.yaml")


@given(st.text(max_size=30))
def test_any_setting_is_applied_or_a_config_error(setting: str):
    try:
        load("toy: chest\ncost: census\n", setting)
    except ConfigError as error:
        assert "--set" in str(error)


def test_a_config_is_laid_over_its_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write(
        tmp_path,
        low="pipeline: local\ncost: {method: census, window: [5, 5]}\noptimization: {method: scanline, p1: 0.7}\n",
        middle="base: low\nrefinement: [median]\noptimization: {p2: 3.0}\n",
        top="base: middle.yaml\ncost: {method: rank}\n",
        other="base: low\npipeline: opencv_bm\n",
    )
    monkeypatch.setattr("depthcli.core.config_file.find_preset", lambda command, name: tmp_path / "top.yaml")
    other = load_config(StereoConfig, tmp_path / "other.yaml")
    assert other.model_dump()["pipeline"] == "opencv_bm"  # a file beside the config wins over a preset
    config = load_config(StereoConfig, tmp_path / "top.yaml")
    dumped = config.model_dump(mode="json")
    assert dumped["cost"]["method"] == "rank"  # another method brings nothing of the base's parameters
    assert (dumped["optimization"]["p1"], dumped["optimization"]["p2"]) == (0.7, 3.0)
    assert [step["method"] for step in dumped["refinement"]] == ["median"]
    assert "base" not in dump_config(config)


def test_mistakes_of_bases_and_of_nested_keys_are_told_where_they_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write(
        tmp_path,
        one="base: two\n",
        two="base: one\n",
        none="base: nowhere\n",
        odd="base: [1]\n",
        wrong="pipeline: local\ncost: {method: census, windw: 3}\n",
        over="base: wrong\naggregation: cros\n",
        keys="pipeline: segments\ncost: census\nkeypoints: {method: SURF, treshold: 1}\n",
        low="pipeline: opencv_bm\n",
        fuse="measures: [{method: census, windw: [5, 5]}]\n",
    )
    for name in ("one", "none", "odd", "over", "keys"):
        with saying(ConfigError):
            load_config(StereoConfig, tmp_path / f"{name}.yaml")
    with saying(ConfigError):
        load_config(FuseConfig, tmp_path / "fuse.yaml")
    monkeypatch.setattr("depthcli.core.config_file.find_preset", lambda command, name: tmp_path / "low.yaml")
    assert load_config(StereoConfig, tmp_path / "none.yaml").pipeline.method_name() == "opencv_bm"


def test_the_field_s_abbreviations_are_names(tmp_path: Path):
    text = "pipeline: LOCAL\ncost: AD\naggregation: cw\noptimization: {method: SGM}\nrefinement: [LRC, Median]\n"
    write(tmp_path, a=f"{text}confidence: [PKR, Lrc]\n", b="pipeline: SGBM\n")
    dumped = load_config(StereoConfig, tmp_path / "a.yaml").model_dump(mode="json")
    names = [dumped[key]["method"] for key in ("cost", "aggregation", "optimization")]
    assert names == ["absolute_difference", "constant_window", "scanline"]
    assert [step["method"] for step in dumped["refinement"]] == ["left_right_check", "median"]
    assert dumped["confidence"] == ["pkr", "lrc"]
    assert load_config(StereoConfig, tmp_path / "b.yaml").model_dump()["pipeline"] == "opencv_sgbm"


STAGES = ("cost", "aggregation", "optimization", "refinement", "boundary", "pipeline")
STEREO = [f"methods.stereo.{stage}" for stage in STAGES]
FAMILIES = (*STEREO, "algorithms.keypoints", "algorithms.segmentation")
METHODS = [f.load(n) for f in (Family.of(f"depthcli.{each}") for each in FAMILIES) for n in f.names()]
MODELS: list[type[BaseModel]] = [*METHODS, FuseConfig, StereoConfig]


def unbounded(schema: Any, path: str) -> Iterator[str]:
    if isinstance(schema, list):
        for scene in schema:
            yield from unbounded(scene, path)
    if not isinstance(schema, dict):
        return
    if schema.get("type") in ("integer", "number") and "enum" not in schema and "const" not in schema:
        low, high = ({"minimum", "exclusiveMinimum"} & set(schema), {"maximum", "exclusiveMaximum"} & set(schema))
        if not (low and high):
            yield path
    for key, value in schema.items():
        yield from unbounded(value, path if key in ("anyOf", "properties", "$defs", "items") else f"{path}.{key}")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_number_has_bounds(model: type[BaseModel]):
    assert not list(unbounded(model.model_json_schema(mode="validation"), model.__name__))
