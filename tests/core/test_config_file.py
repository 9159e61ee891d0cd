from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from depthcli.core.config_file import dump_config, load_config, parse_config, read_config
from depthcli.core.errors import ConfigError
from depthcli.core.method import RootConfig
from tests.core.toys import AnyToy


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


def test_fields_of_the_method_stand_at_the_root():
    root = load("toy: box\nsize: [7, 9]\ntop: 4\n")
    assert root.top == 4
    assert root.toy.size == (7, 9)


def test_a_method_is_a_name_or_a_mapping():
    assert load("toy: chest\ncost: census\n") == load("toy: chest\ncost: {method: census}\n")
    assert load("toy: chest\ncost: {method: census, window: [5, 5]}").toy.cost.window == (5, 5)


def test_every_problem_is_reported_with_its_line():
    text = (
        "toy: chest\n"
        "cost: {method: census, windw: [9, 7]}\n"
        "widht: 3\n"
        "top: 0\n"
        "parts:\n"
        "  - census\n"
        "  - censsus\n"
        "  - method: rank\n"
        "    window: [3, x]\n"
    )
    names = "absolute_difference, census, combined, gradient, rank"
    got = problems(text)
    assert got[3].startswith("f.yaml:7: parts.1: no method called 'censsus'; did you mean 'census'?; one of: ")
    assert all(name in got[3] for name in names.split(", "))
    del got[3]
    assert got == [
        "f.yaml:2: cost.windw: no such key (got [9, 7]); did you mean 'window'?",
        "f.yaml:3: widht: no such key (got 3); did you mean 'width'?",
        "f.yaml:4: top: should be greater than or equal to 1 (got 0)",
        'f.yaml:9: parts.2.window.1: should be a valid integer, unable to parse string as an integer (got "x")',
    ]


def test_a_renamed_key_is_refused_with_its_name_of_today():
    assert problems("toy: box\nheft: 2\nupper: 3\n") == [
        "f.yaml:2: heft: no such key (got 2); did you mean 'weight'?",
        "f.yaml:3: upper: no such key (got 3); did you mean 'top'?",
    ]
    assert problems("toy: box\n", "heft=2") == ["--set heft: no such key (got 2); did you mean 'weight'?"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("toy: bx\n", "f.yaml:1: toy: no toy called 'bx'; did you mean 'box'?; one of: box, chest"),
        ("top: 3\n", "f.yaml: toy: missing, and it has no default"),
        ("toy: chest\n", "f.yaml: cost: missing, and it has no default"),
        ("toy: box\ntoy: box\n", "f.yaml:2: toy: written twice (first in line 1)"),
        ("toy: box\nweight: .nan\n", "f.yaml:2: weight: should be a finite number (got NaN)"),
        ("toy: box\nweight: .inf\n", "f.yaml:2: weight: should be a finite number (got Infinity)"),
        ("toy: box\n\tsize: [1, 2]\n", "f.yaml:2: not valid YAML (a tab; YAML wants spaces for indentation)"),
        ("", "f.yaml: the file is empty; want a mapping of keys to values"),
        ("# only a comment\n", "f.yaml: the file is empty; want a mapping of keys to values"),
        ("- toy\n- box\n", "f.yaml:1: want a mapping of keys to values at the root, got a list"),
        ("\n7\n", "f.yaml:2: want a mapping of keys to values at the root, got a single value"),
        ("toy: *box\n", "f.yaml:1: not valid YAML (found undefined alias 'box')"),
        ("toy: &a [*a]\n", "f.yaml:1: too large, nested too deeply, or an anchor that contains itself"),
        ("a: &a\n  <<: *a\n", "f.yaml:2: an anchor that contains itself"),
        ("toy: " + "[" * 5000, "f.yaml: nested too deeply"),
        ("toy: !!python/name:os.system x\n", "f.yaml:1: toy: want plain YAML, got the tag 'python/name:os.system'"),
        ("? [a]\n: b\n", "f.yaml:1: a key must be a name"),
        ("toy: box\n--- \ntoy: box\n", "not valid YAML (expected a single document"),
        ("toy: \x00\n", "f.yaml: not valid YAML (special characters are not allowed)"),
        ("toy: box\nsize: [1, 2, 3]\n", "f.yaml:2: size: "),
    ],
)
def test_wrong_yaml_of_every_kind(text: str, said: str):
    assert any(said in line for line in problems(text)), problems(text)


def test_an_alias_bomb_is_defused():
    levels = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9))
    (line,) = problems("a0: &a0 [x, x]\n" + levels)
    assert "too large" in line


def test_files_that_are_no_text(tmp_path: Path):
    file = tmp_path / "c.yaml"
    for data, said in (
        (b"toy: \xff\xfe", "not UTF-8"),
        (b"\x89PNG\r\n\x1a\n", "not UTF-8"),
        (b"x" * (1 << 21), "larger than 1 MiB"),
    ):
        file.write_bytes(data)
        with pytest.raises(ConfigError, match=said):
            read_config(file)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_config(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_config(tmp_path / "absent.yaml")


def test_anchors_and_merge_keys():
    root = load("toy: chest\ncost: &c {method: census, window: [5, 5]}\nparts: [{<<: *c, window: [3, 3]}, *c]\n")
    assert [part.window for part in root.toy.parts] == [(3, 3), (5, 5)]


def test_numbers_without_a_dot_are_numbers():
    assert load("toy: box\nweight: 1e-3\n").toy.weight == 1e-3


def test_set_overrides_what_the_file_says():
    text = "toy: chest\ncost: census\nparts: [rank, census]\n"
    root = load(text, "cost.window=[5,5]", "parts.0.window=[7, 7]", "parts.1=gradient", "width=1", "width=2", "mode=~")
    assert root.toy.cost.window == (5, 5)
    assert root.toy.parts[0].window == (7, 7)
    assert root.toy.parts[1].method_name() == "gradient"
    assert (root.toy.width, root.toy.mode) == (2, None)


def test_set_reaches_below_a_default():
    assert load("toy: box\n", "size.1=9").toy.size == (3, 9)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("parts.5=census", "--set parts.5: parts has 1 entries; the last index is 0 (got 5)"),
        ("parts.x=census", "--set parts.x: parts is a list of 1; want an index such as parts.0 (got 'x')"),
        ("width.x=3", "--set width.x: width is a single value, nothing can be set below it"),
        ("width", "--set width: want KEY=VALUE, such as --set cost.window=[9,7]"),
        ("=3", "--set =3: want KEY=VALUE, such as --set cost.window=[9,7]"),
        ("widht=3", "--set widht: no such key (got 3); did you mean 'width'?"),
        ("cost.window=[9", "--set cost.window: not valid YAML"),
        ("top=0", "--set top: should be greater than or equal to 1 (got 0)"),
        ("cost.window.0=x", "--set cost.window.0: should be a valid integer"),
    ],
)
def test_set_says_what_is_wrong(setting: str, said: str):
    text = "toy: chest\ncost: census\nparts: [rank]\nwidth: 1\n"
    assert any(line.startswith(said) for line in problems(text, setting)), problems(text, setting)


def test_dump_reads_back_and_is_stable():
    root = load("toy: chest\ncost: census\nparts: [rank, {method: absolute_difference}]\n")
    text = dump_config(root)
    assert load(text) == root
    assert dump_config(load(text)) == text
    assert load(dump_config(load("toy: box\n"))).toy.weight == 1e-6


def test_what_run_files_add_is_ignored():
    assert dump_config(load("toy: box\nrun: {command: stereo, versions: {numpy: '2.0'}}\n")) == dump_config(
        load("toy: box\n")
    )


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
