from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.progress import Activity, announce_stage, counted, listening
from depthcli.core.result import Clock
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.tiling.coarse_to_fine import match_in_tiles
from depthcli.methods.stereo.tiling.plan import Memory


def test_stages_and_things_within_them_are_announced_when_they_begin():
    heard: list[Activity] = []
    clock = Clock()
    with listening(heard.append):
        clock.start("cost")
        for _ in counted("ab", "tile"):
            clock.start("cost")
            Clock("coarse").start("inner")
        clock.start("refinement")
    announce_stage("later")
    assert heard == [
        Activity("cost"), Activity("cost", "tile", 1, 2), Activity("cost", "tile", 1, 2),
        Activity("coarse inner", "tile", 1, 2), Activity("coarse inner", "tile", 2, 2), Activity("cost", "tile", 2, 2),
        Activity("coarse inner", "tile", 2, 2), Activity("coarse inner"), Activity("refinement"),
    ]  # fmt: skip


def test_one_thing_alone_is_not_counted():
    heard: list[Activity] = []
    with listening(heard.append):
        assert list(counted([5], "tile")) == [5]
    assert {activity.total for activity in heard} == {0}


def test_listeners_are_put_back():
    outer: list[Activity] = []
    with listening(outer.append):
        with listening(lambda activity: None):
            announce_stage("inner")
        announce_stage("outer")
    assert outer == [Activity("outer")]


def test_tiles_of_a_pair_are_announced_with_their_stages():
    heard: list[Activity] = []
    rng = np.random.default_rng(0)
    pair = StereoPair(*rng.integers(0, 255, (2, 256, 320, 3), np.uint8))
    with listening(heard.append):
        result = match_in_tiles(Local(cost=Census()), pair, 15, Memory(6 << 20, 0), Clock())
    n_tiles = int(result.figures["tiles"])
    assert n_tiles > 1
    assert [a.number for a in heard if a.stage == "optimization" and a.total == n_tiles] == list(range(1, n_tiles + 1))
    assert heard[-1].total == 0


def test_a_clock_takes_over_what_another_one_timed(monkeypatch: pytest.MonkeyPatch):
    now = iter([10.0, 18.0, 20.0, 21.0])
    monkeypatch.setattr("depthcli.core.result.time.perf_counter", lambda: next(now))
    clock = Clock()
    clock.start("other")
    clock.include({"cost": 3.0, "refinement": 4.0})
    clock.start("save")
    seconds = clock.seconds
    assert list(seconds.items()) == [("cost", 3.0), ("refinement", 4.0), ("other", 3.0), ("save", 1.0)]
