"""The list of kernels that presets call: every entry is there, and its types survive as text."""

from __future__ import annotations

import importlib
from typing import NamedTuple

import numpy as np
import pytest
from numba import typeof

from depthcli.kernels.calls import describe_type, missing_calls, parse_type, recorded_calls, recorded_presets
from depthcli.run.presets import list_presets


class Parts(NamedTuple):
    a: np.ndarray
    b: np.ndarray


class Mixed(NamedTuple):
    a: int
    b: np.ndarray


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((2, 3), np.float32), np.zeros((2, 3, 4), np.uint8)[:, ::2], np.zeros((2, 3), np.bool_).T, 3, 2.5, True,
        np.float32(1), np.uint16(1), None, (1, 2), (1, np.zeros(3)), Parts(np.zeros(1), np.zeros(2)),
        Mixed(1, np.zeros((1, 1), np.int16)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("writeable", [True, False])
def test_types_survive_as_text(value: object, writeable: bool):
    if isinstance(value, np.ndarray):
        value.setflags(write=writeable)
    assert parse_type(describe_type(typeof(value))) == typeof(value)


def test_other_types_have_no_text():
    with pytest.raises(ValueError, match="no text"):
        describe_type(typeof("text"))


def test_every_preset_is_listed():
    presets = (f"{command}/{name}" for command, name, _ in list_presets())
    assert recorded_presets() == sorted([*presets, "confidence", "fuse-maps"])


def test_every_kernel_of_the_list_is_there():
    calls = recorded_calls(recorded_presets())
    for call in calls:
        assert hasattr(getattr(importlib.import_module(call.module), call.kernel), "py_func"), call
        types = [parse_type(text) for text in call.arguments]
        assert [describe_type(kind) for kind in types] == [*call.arguments]
    assert len({call.key for call in calls}) == len(calls)
    assert [call.seconds for call in calls] == sorted((call.seconds for call in calls), reverse=True)


def test_calls_are_missing_where_no_folder_holds_their_kernels(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("depthcli.kernels.cache.KernelCache.holds", lambda self, types, target: len(types) < 4)
    calls = recorded_calls(["stereo/fast"])
    assert missing_calls("stereo/fast") == [call for call in calls if len(call.arguments) >= 4] != []
    assert missing_calls("no/preset") == []
