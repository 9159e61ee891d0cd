"""Pairs that do not fit into memory: the same or nearly the same map, whatever was allowed."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.context import Clock
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.memory import BASE_BYTES
from depthcli.io.formats.images import write_png
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo import tiling
from depthcli.methods.stereo.matching import Limits, host_bytes, match
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.stages import CostStages, PairMatcher
from depthcli.methods.stereo.tiling import tile_by_tile
from depthcli.methods.stereo.tiling.plan import BIN, BLOCK, PROCESS_BYTES, Candidates, Margins, Span, Tile
from depthcli.methods.stereo.tiling.tile_by_tile import Prior, TiledWinners, refined_map
from depthcli.methods.stereo.volume import StereoResult
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import TINY, assert_pure, blocky_pair, random_volume, texture
from tests.command_line import rows
from tests.conftest import sampled
from tests.contracts.checks import assert_in_range
from tests.contracts.inputs import COMBINED, preset, views, wrong
from tests.naive import stereo as naive

PRESETS = ("fast", "accurate", "segments", "opencv-sgbm", "ad-census-mei", "cross")


def match_in_tiles(matcher: PairMatcher, pair: StereoPair, top: int, memory: int) -> StereoResult:
    return match(matcher, pair, top, Limits(memory, tiles="always"))


def least_memory(matcher, pair: StereoPair, top: int) -> StereoResult:
    """The result with about the least memory that suffices, so with the smallest tiles."""
    for extra in range(400):
        allowed = PROCESS_BYTES + pair.left.nbytes * 2 + int(2**16 * 1.2**extra)
        try:
            return match_in_tiles(matcher, pair, top, allowed)
        except InputError:
            continue
    raise AssertionError("nothing sufficed")


@pytest.fixture
def small_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images and ranges of tests count as large."""
    monkeypatch.setattr(tiling, "_MIN_DISPARITIES", 16)
    monkeypatch.setattr(tiling, "_MIN_SIDE", 48)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_winners_of_tiles_with_disparities_of_their_own(dtype):
    shape, barrier = (6, 40), np.zeros((6, 40, 1), dtype)
    costs = random_volume(*shape, 24, dtype, 3).costs
    parts = [(0, 13, [(0, 8), (14, 6)]), (13, 29, [(3, 9)]), (29, 40, [(0, 4), (9, 5), (20, 4)])]
    gathered = TiledWinners(shape, True)
    allowed = np.zeros(costs.shape, bool)
    for x0, x1, listed in parts:
        spans, cells, start = [], [], 0
        for low, count in listed:
            allowed[:, x0:x1, low : low + count] = True
            spans.append((start, count, low))
            cells += [costs[:, :, low : low + count], barrier]
            start += count + 1
        volume = np.ascontiguousarray(np.concatenate(cells[:-1], axis=2))
        gathered.add(volume, np.array(spans, np.int64), Tile((0, 6), (x0, x1), (0, 6, 0, 40), ()))
    left, right, minima = naive.gathered_winners(costs, allowed)
    np.testing.assert_array_equal(gathered.left, left)
    there = right >= 0
    np.testing.assert_array_equal(gathered.right()[there], right[there])
    np.testing.assert_allclose(gathered.minima, minima, atol=1e-4)


def test_tiles_cover_the_image_once_and_search_all_candidates():
    rng = np.random.default_rng(5)
    shape, top = (470, 333), 150
    bins = rng.random((-(-shape[0] // BLOCK), -(-shape[1] // BLOCK), top // BIN + 1)) < 0.1
    candidates = Candidates(bins, shape, top)

    def fits(tile: Tile) -> bool:
        return tile.shape[0] * tile.shape[1] * tile.n_disparities <= 3_000_000

    for margins in (Margins(20, 8, False), Margins(20, 8, True)):
        tiles = candidates.tiles(margins, fits)
        assert tiles is not None and len(tiles) > 1
        seen = np.zeros(shape, int)
        for tile in tiles:
            seen[tile.place] += 1
            assert fits(tile)
            assert len(tile.spans) == 1 or not margins.whole
            searched = {d for span in tile.spans for d in range(span.low, span.low + span.n)}
            assert max(searched) <= top
            around = ((max(0, a - 20), b + 20) for a, b in (tile.rows, tile.columns))
            rows, columns = (slice(a // BLOCK, -(-b // BLOCK)) for a, b in around)
            wanted = np.flatnonzero(bins[rows, columns].any(axis=(0, 1))) * BIN
            assert {int(d) for d in wanted if d < tile.columns[1]} <= searched
            assert min(searched) <= tile.columns[0]  # the first pixel has a candidate
        assert np.all(seen == 1)
    assert candidates.tiles(Margins(20, 8, False), lambda tile: False) is None


@pytest.mark.parametrize(("cost", "least"), [("absolute_difference", 255), ("intensity_gradient", 1e4),
                                             ("intensity_gradient", 1)])  # fmt: skip
def test_the_costs_of_a_tile_are_parts_of_the_costs_of_the_pair(cost, least, monkeypatch):
    monkeypatch.setattr(tile_by_tile, "_FLOAT_BARRIER", least)
    pair, stages, top = blocky_pair(30, 40), CostStages(cost=cost, optimization="scanline"), 25
    whole = stages.volume(pair, top, Clock()).costs
    tile = Tile((0, 20), (5, 35), (0, 20, 3, 38), (Span(0, 4), Span(9, 5), Span(17, 8)))
    half = (15, 20)
    low, high = (np.full(half, d, np.int16) for d in (2, 10))
    prior = Prior(np.zeros(half, np.float32), Candidates.everywhere((30, 40), top), low, high, np.zeros((2, *half)), 2)
    (volume, table), (penalized, _) = (
        tile_by_tile._tile_volume(stages, pair, tile, each, Clock()) for each in (None, prior)
    )
    assert volume.costs.shape == (20, 35, 4 + 5 + 8 + 2)
    assert table.tolist() == [[0, 4, 0], [5, 5, 9], [11, 8, 17]]
    largest = max(least, volume.costs.max())
    penalty, edge = max(1, round(0.2 * stages.optimization.p1 * volume.scale)), stages.cost.halo()
    rows = slice(edge, 20 - edge)
    for start, count, first in table.tolist():
        disparities, cells = np.arange(first, first + count), volume.costs[:, :, start : start + count]
        # The tile's right image has the matches of all its columns at the span's first disparity.
        match = np.arange(3, 38)[:, None] - disparities
        inside = (match >= max(0, 3 - first) + edge) & (match < 38 - first - edge)
        inside[:edge] = inside[35 - edge :] = False
        np.testing.assert_array_equal(cells[rows, inside], whole[:20, 3:38, disparities][rows, inside])
        added = np.where((disparities < 2) | (disparities > 10), penalty, 0)
        assert start == 11 or (volume.costs[:, :, start + count] >= max(least, cells.max())).all()
        expected = np.minimum(cells.astype(float) + added, largest)
        np.testing.assert_allclose(penalized.costs[:, :, start : start + count], expected, rtol=1e-6)


TOLERANT = {"method": "combined", "parts": [
    {"cost": {"method": "absolute_difference", "sampling": "tolerant"}, "lambda": 20},
    {"cost": {"method": "gradient", "sampling": "tolerant"}, "lambda": 4},
    {"cost": {"method": "zncc", "window": [5, 5]}, "lambda": 0.5}, {"cost": "rank", "lambda": 9},
]}  # fmt: skip
LOCAL = {
    "window": ("census", {"method": "constant_window", "window": 9}),
    "combined": (COMBINED, {"method": "constant_window", "window": 5}),
    "tolerant": (TOLERANT, None),
    "cross": ("census", {"method": "cross", "length": 9, "inner_length": 5, "iterations": 2}),
    "intersection": ("census", {"method": "cross", "length": 9, "support": "intersection", "iterations": 1}),
    "adaptive": ({"method": "census", "window": [3, 3]}, {"method": "adaptive_weight", "window": 9}),
}
STEPS = [
    "left_right_check", {"method": "speckle_filter", "size": 20}, "subpixel", {"method": "surface_fill", "rows": 5},
    "background_fill", "median", {"method": "weighted_median", "radius": 2},
    {"method": "slanted_median", "radius": 3, "slope_radius": 8},
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("cost", "aggregation"), LOCAL.values(), ids=LOCAL)
def test_local_methods_give_the_same_bytes_in_tiles(cost, aggregation, monkeypatch):
    monkeypatch.setattr(tile_by_tile, "_BAND_PIXELS", 2000)  # refinement in several bands, too
    fields = {"cost": cost, "aggregation": aggregation, "refinement": STEPS, "confidence": ["msm"]}
    pipeline = Local.model_validate(fields)
    pair = views(make_scene("planes", 3, 200, 150, 40))
    whole = pipeline(pair, 40)
    result = least_memory(pipeline, pair, 40)
    assert result.figures["tiles"] > 3 and result.figures["exact"] == 1
    np.testing.assert_array_equal(result.disparity.values, whole.disparity.values)
    np.testing.assert_array_equal(result.disparity.status, whole.disparity.status)
    np.testing.assert_array_equal(result.confidence["msm"], whole.confidence["msm"])


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PRESETS, "fusion"])
def test_every_kind_of_preset_nearly_the_same_map_in_tiles(name, small_levels):
    fields = {"measures": ["census", "absolute_difference"], "confidence": ["consensus"]}
    pipeline = Fusion.model_validate(fields) if name == "fusion" else preset("stereo", name).pipeline
    made, results = make_scene("planes", 1, 300, 210, 48), []
    pair = views(made)

    def run() -> np.ndarray:
        results.append(match_in_tiles(pipeline, pair, 48, PROCESS_BYTES + (96 << 20)))
        return np.stack([results[-1].disparity.values, results[-1].disparity.status])

    assert_pure(run, pair.left, pair.right)
    figures = results[0].figures
    assert figures["levels"] == (1 if figures["exact"] else 3)
    whole = pipeline(pair, 48)
    assert wrong(results[0], made) <= wrong(whole, made) + 0.02
    assert_in_range(results[0].disparity, pair.shape, 48)
    shapes, expected = ({n: v.shape for n, v in each.confidence.items()} for each in (results[0], whole))
    assert shapes == expected


def test_thin_things_are_found_although_small_images_lose_them(small_levels, monkeypatch):
    monkeypatch.setattr(tiling, "_MIN_DISPARITIES", 32)
    near, far, wall = 56, 12, texture((260, 400, 3), 1)
    pair = StereoPair(wall[:, 40:360].copy(), wall[:, 40 + far : 360 + far].copy())
    bar = texture((260, 4, 3), 2)  # a pixel at a quarter of the size
    for view, x in ((pair.left, 200), (pair.right, 200 - near)):
        view[15:245, x : x + 4] = bar[15:245]
    pipeline = preset("stereo", "accurate").pipeline
    result = match_in_tiles(pipeline, pair, 63, PROCESS_BYTES + (96 << 20))
    assert result.figures["levels"] == 3
    found, whole = (
        np.mean(np.abs(each.disparity.values[20:240, 200:204] - near) <= 1) for each in (result, pipeline(pair, 63))
    )
    assert found > whole - 0.1


@pytest.mark.parametrize("name", ["fast", "accurate", "opencv-sgbm", "cross"])
@pytest.mark.parametrize(("height", "width", "disparities"), [*TINY, (3, 300, 250), (300, 3, 250), (50, 70, 300)])
def test_tiny_and_narrow_images_and_wide_ranges(name, height, width, disparities, small_levels):
    result = match_in_tiles(preset("stereo", name).pipeline, blocky_pair(height, width), disparities, 1 << 30)
    assert_in_range(result.disparity, (height, width), disparities)


def test_the_command_says_what_it_did(tmp_path: Path, tmp_path_factory, tool):
    scenes = sampled(tmp_path_factory, "-n", "1", "--width", "160", "--height", "120", "--max-disparity", "20")
    arguments = ["stereo", "fast", "-i", scenes, "-o"]
    always = ["--set", "tiles=always", "--set", "min_disparity=3"]
    tool.told(0, *arguments, tmp_path / "u", *always, "--max-memory", "1GiB")
    assert "matched in" not in tool.err(0, *arguments, tmp_path / "t", *always, "--set", "tile_memory=900")
    (row,) = rows(tmp_path / "t").values()
    assert (row["tiles"], row["levels"], row["exact"]) == (1, 1, 0)
    tool.told(3, *arguments, tmp_path / "n", "--set", "tiles=never", "--max-memory", "1MiB")
    tool.told(3, *arguments, tmp_path / "a", "--max-memory", "1MiB")


def test_a_pair_that_may_be_matched_in_tiles_takes_no_more_than_they():
    pipeline, shape = preset("stereo", "fast").pipeline, (700, 1000)
    need, tiles = pipeline.peak_bytes(shape, 240), 400 << 20
    in_tiles = tiles - BASE_BYTES
    for mode, tile_memory, expected in (("auto", tiles, in_tiles), ("never", tiles, need), ("auto", need, need)):
        assert host_bytes(pipeline, shape, 240, Limits(1 << 40, mode, tile_memory)) == expected


@pytest.mark.slow
def test_speckles_as_large_as_thin_structures_go_but_for_these():
    found = TiledWinners((24, 32), False)
    found.left[:] = 5
    stays, goes, small = np.s_[4:7, 4:7], np.s_[4:7, 20:23], np.s_[14:16, 4:6]  # more than 4 pixels, or not
    found.left[stays] = found.left[goes] = found.left[small] = 15
    image, half = np.zeros((24, 32, 3), np.uint8), np.zeros((12, 16), np.int16)
    thin = np.full((2, 12, 16), 1000, np.float32)  # none
    thin[0, :5, :6], thin[1, :5, :6] = 14, 15
    prior = Prior(half.astype(np.float32), Candidates.__new__(Candidates), half, half, thin, 2)
    refined = refined_map([SpeckleFilter(size=4)], found, StereoPair(image, image), 31, prior)
    removed = np.zeros((24, 32), bool)
    removed[goes] = removed[small] = True
    np.testing.assert_array_equal(np.isnan(refined.values), removed)
    np.testing.assert_array_equal(refined.values[~removed], found.left[~removed])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak sizes of processes are measured on Linux")
@pytest.mark.skipif("NUMBA_BOUNDSCHECK" in os.environ, reason="checked kernels are compiled anew, which takes memory")
def test_the_process_stays_within_the_memory_allowed(tmp_path: Path):
    wall = texture((700, 1060, 3), 4)
    for name, view in (("left", wall[:, :1000]), ("right", wall[:, 60:])):
        write_png(tmp_path / "in" / "scene" / f"{name}.png", view)
    command = [sys.executable, "-m", "depthcli", "stereo", "fast", "-i", str(tmp_path / "in"), "--max-disparity", "240"]
    assert preset("stereo", "fast").pipeline.peak_bytes((700, 1000), 240) > 700 << 20
    for turn in range(2):  # the first one may compile
        subprocess.run([*command, "-o", str(tmp_path / f"{turn}"), "--max-memory", "500MiB", "-q"], check=True)
    (row,) = rows(tmp_path / "1").values()
    assert row["tiles"] > 1
    assert 200 << 20 < row["peak_memory"] <= 500 << 20  # by the process itself: a child's own figure counts its parent
