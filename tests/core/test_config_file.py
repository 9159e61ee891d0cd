"""Configs: where each mistake stands, ``--set``, a config over another one, the text of a resolved one, bounds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from depthcli.core.config_file import dump_config, load_config
from depthcli.core.errors import ConfigError
from depthcli.core.method import Family, RootConfig
from depthcli.core.yaml_source import parse_config, read_config
from depthcli.problems.fusion import FuseConfig
from depthcli.problems.stereo import StereoConfig
from tests.core.toys import AnyToy
from tests.golden import refused, saying


class Root(RootConfig):
    flattened: ClassVar[str] = "toy"
    renamed: ClassVar[dict[str, str]] = {"upper": "top"}
    toy: AnyToy
    top: int | None = Field(None, ge=1)


def load(text: str, *settings: str) -> Root:
    return load_config(Root, parse_config(text, "f.yaml"), settings)


def problems(text: str, *settings: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(text, *settings)
    return str(caught.value).splitlines()


def write(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)


def test_a_method_is_a_name_or_a_mapping_and_its_fields_stand_at_the_root():
    root = load("toy: box\nsize: [7, 9]\ntop: 4\n")
    assert (root.top, root.toy.size) == (4, (7, 9))
    assert load("toy: chest\ncost: census\n") == load("toy: chest\ncost: {method: census}\n")
    assert load("toy: chest\ncost: {method: census, window: [5, 5]}").toy.cost.window == (5, 5)


def test_symbols_are_other_names_of_keys_for_options(tmp_path: Path):
    write(tmp_path, a="toy: box\nsize: [7, 9]\nsymbols: {T: top, H: size.1}\n", b="base: a\nsymbols: {T: size.0}\n")
    root = load_config(Root, tmp_path / "a.yaml", ["T=4", "H=3"])
    assert (root.top, root.toy.size) == (4, (7, 3))
    root = load_config(Root, tmp_path / "b.yaml", ["T=4", "H=3"])
    assert (root.top, root.toy.size) == (None, (4, 3))
    assert "symbols" not in dump_config(root)
    with saying(ConfigError):
        load_config(Root, tmp_path / "a.yaml", ["T=x"])
    assert problems("toy: box\nsize: [7, 9]\nsymbols: [T]\n") == [
        "f.yaml:3: symbols: expected symbols and their keys, such as w: energy.smoothness"
    ]


def test_every_problem_is_reported_with_its_line():
    got = problems(
        "toy: chest\ncost: {method: census, windw: [9, 7]}\nwidht: 3\ntop: 0\nparts:\n  - census\n  - censsus\n"
        "  - method: rank\n    window: [3, x]\nupper: 3\ntopp: 2\n"
    )
    assert got[3].startswith("f.yaml:7: parts.1: no method called 'censsus'; did you mean 'census'?; one of: absolute")
    del got[3]
    assert got == [
        "f.yaml:2: cost.windw: no such key (got [9, 7]); did you mean 'window'?",
        "f.yaml:3: widht: no such key (got 3); did you mean 'width'?",
        "f.yaml:4: top: should be greater than or equal to 1 (got 0)",
        'f.yaml:9: parts.2.window.1: should be a valid integer, unable to parse string as an integer (got "x")',
        "f.yaml:10: upper: no such key (got 3); did you mean 'top'?",
        "f.yaml:11: topp: no such key (got 2); did you mean 'top'?",
    ]
    assert problems("toy: box\n", "heft=2") == ["--set heft: no such key (got 2); did you mean 'weight'?"]


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("toy: bx\n", "f.yaml:1: toy: ", "no toy called 'bx'; did you mean 'box'?; one of: box, chest"),
        ("toy: chest\n", "f.yaml: cost: ", "missing"),
        ("toy: box\nweight: .nan\n", "f.yaml:2: weight: ", "finite number (got NaN)"),
        ("toy: box\nsize: [1, 2, 3]\n", "f.yaml:2: size: ", ""),
        ("toy: box\ntoy: box\n", "f.yaml:2: ", "toy is written twice, first in line 1"),
        ("toy: box\n\tsize: [1, 2]\n", "f.yaml:2: ", "a tab"),
        ("# only a comment\n", "f.yaml: ", "expected a mapping of keys to values, got nothing"),
        ("toy: *box\n", "f.yaml:1: ", "undefined alias 'box'"),
        ("toy: " + "[" * 5000, "f.yaml: ", "nested too deeply"),
        ("a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [{f'*a{n - 1}, ' * 9}]\n" for n in range(1, 9)), "", "too large"),
        ("toy: !!python/name:os.system x\n", "f.yaml:1: ", "unknown tag tag:yaml.org,2002:python/name:os.system"),
        ("? [a]\n: b\n", "f.yaml:1: ", "a key must be a name"),
        ("toy: box\n--- \ntoy: box\n", "f.yaml:2: ", "expected a single document"),
        ("toy: \x00\n", "f.yaml: ", "special characters are not allowed"),
    ],
)
def test_wrong_yaml_of_every_kind(text: str, place: str, said: str):
    assert any(line.startswith(place) and said in line for line in problems(text)), problems(text)


@pytest.mark.parametrize("data", [b"toy: \xff\xfe", b"x" * (1 << 21), None])
def test_files_that_are_no_text(data: bytes | None, tmp_path: Path):
    file = tmp_path / "c.yaml"
    if data is not None:
        file.write_bytes(data)
    refused(ConfigError, read_config, file)


def test_anchors_merge_keys_and_numbers_without_a_dot():
    root = load("toy: chest\ncost: &c {method: census, window: [5, 5]}\nparts: [{<<: *c, window: [3, 3]}, *c]\n")
    assert [part.window for part in root.toy.parts] == [(3, 3), (5, 5)]
    assert load("toy: box\nweight: 1e-3\n").toy.weight == 1e-3


def test_numbers_are_numbers():
    """Truth values and the octal and sexagesimal numbers of YAML 1.1 are refused."""
    truth = "should be a number, and is true or false"
    assert problems("toy: box\ntop: yes\n") == [f"f.yaml:2: top: {truth} (got true)"]
    assert problems("toy: box\nsize: [7, true]\n") == [f"f.yaml:2: size: {truth} (got [7, true])"]
    assert problems("toy: box\n", "top=true") == [f"--set top: {truth} (got true)"]
    assert problems("toy: box\n\ntop: 010\n") == [
        "f.yaml:3: not valid YAML (010 is 8 in YAML; write 8, or quote it if it is no number)"
    ]
    assert "1:30 is 90 in YAML" in problems("toy: box\ntop: 1:30\n")[0]
    assert "1:30.5 is 90.5" in problems("toy: box\n", "top=1:30.5")[0]
    assert load("toy: box\ntop: 0x10\n").top == 16


def test_set_overrides_what_the_file_says():
    text = "toy: chest\ncost: census\nparts: [rank, census]\n"
    root = load(text, "cost.window=[5,5]", "parts.0.window=[7, 7]", "parts.1=gradient", "width=1", "width=2", "mode=~")
    assert root.toy.cost.window == (5, 5)
    assert root.toy.parts[0].window == (7, 7)
    assert root.toy.parts[1].method_name() == "gradient"
    assert (root.toy.width, root.toy.mode) == (2, None)
    assert load("toy: box\n", "size.1=9").toy.size == (3, 9)  # below a default


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("parts.1=census", "--set parts.1: parts is a list of 1; expected an index (got 1)"),
        ("width.x=3", "--set width.x: width is a single value"),
        ("width", "--set width: expected KEY=VALUE"),
        ("=3", "--set : expected the name of a key"),
        ("widht=3", "--set widht: no such key (got 3); did you mean 'width'?"),
        ("cost.window=[9", "--set cost.window: not valid YAML"),
        ("top=0", "--set top: should be greater than or equal to 1 (got 0)"),
    ],
)
def test_set_says_what_is_wrong(setting: str, said: str):
    text = "toy: chest\ncost: census\nparts: [rank]\nwidth: 1\n"
    assert any(line.startswith(said) for line in problems(text, setting)), problems(text, setting)


def test_options_are_blamed_by_their_name(tmp_path: Path):
    write(tmp_path, c="pipeline: opencv_bm\n", f="measures: [{cost: census}]\n")
    with saying(ConfigError):
        load_config(StereoConfig, tmp_path / "c.yaml", [("--max-disparity", "max_disparity=0")])
    with saying(ConfigError):
        load_config(FuseConfig, tmp_path / "f.yaml", ["measures.0.volume=x.npy"])
    with saying(ConfigError):
        load_config(StereoConfig, tmp_path / "c.yaml", values={"max_disparity": 0})
    for text in ("9" * 6000, "0x" + "f" * 6000, "1e305", "[" * 300):
        with saying(ConfigError):
            load_config(StereoConfig, tmp_path / "c.yaml", [f"max_disparity={text}"])


def test_dump_reads_back_and_is_stable():
    root = load("toy: chest\ncost: census\nparts: [rank, {method: absolute_difference}]\n")
    text = dump_config(root)
    assert load(text) == root and dump_config(load(text)) == text
    assert load(dump_config(load("toy: box\n"))).toy.weight == 1e-6
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
    write(tmp_path, one="base: two\n", two="base: one\n", none="base: nowhere\n", odd="base: [1]\n")
    write(
        tmp_path, wrong="pipeline: local\ncost: {method: census, windw: 3}\n", over="base: wrong\naggregation: cros\n"
    )
    write(tmp_path, keys="pipeline: segments\ncost: census\nkeypoints: {method: SURF, treshold: 1}\n")
    for name in ("one", "none", "odd", "over", "keys"):
        with saying(ConfigError):
            load_config(StereoConfig, tmp_path / f"{name}.yaml")
    write(tmp_path, low="pipeline: opencv_bm\n", fuse="measures: [{method: census, windw: [5, 5]}]\n")
    monkeypatch.setattr("depthcli.core.config_file.find_preset", lambda command, name: tmp_path / "low.yaml")
    found = load_config(StereoConfig, tmp_path / "none.yaml")
    assert found.pipeline.method_name() == "opencv_bm"
    with saying(ConfigError):
        load_config(FuseConfig, tmp_path / "fuse.yaml")


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
