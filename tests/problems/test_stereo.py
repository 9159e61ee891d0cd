"""``stereo``, ``fuse`` and ``matcher`` from Python: results, bytes of saved files, inputs, errors."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import depthcli
from depthcli.core import memory
from depthcli.io.formats.images import read_image
from tests.command_line import in_threads
from tests.golden import refused, saying, told

Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]


@pytest.fixture(scope="module")
def pair(made_scenes: Path) -> Images:
    left, right = (read_image(made_scenes / "planes_0" / f"{side}.png") for side in ("left", "right"))
    return left, right  # type: ignore[return-value]


def test_a_result_describes_itself(pair: Images):
    disparity = depthcli.stereo(*pair, max_disparity=12, preset="fast", confidence=["lrc"])
    assert disparity.values.dtype == np.float32 and disparity.status.dtype == np.uint8
    assert disparity.values.shape == disparity.confidence["lrc"].shape == pair[0].shape[:2]
    assert depthcli.Status(disparity.status[0, 0]) == int(disparity.status[0, 0])
    assert np.array_equal(disparity.filled, (disparity.status & depthcli.Status.FILLED) > 0)
    assert np.array_equal(disparity.measured, disparity.valid & ~disparity.filled)
    assert {"cost", "optimization", "other"} <= set(disparity.seconds)
    assert disparity._repr_png_().startswith(b"\x89PNG")
    assert "96 x 64, searched 0 to 12 px, 100.0 %" in repr(disparity)
    again = pickle.loads(pickle.dumps(disparity))
    assert np.array_equal(again.values, disparity.values) and again.search == disparity.search
    with pytest.raises(AttributeError):
        disparity.values = disparity.values  # type: ignore[misc]
    depth = disparity.to_depth(focal=80.0, baseline=0.2, mask=disparity.measured)
    assert np.array_equal(depth.valid, disparity.measured)
    assert len(depth.to_points()) == np.count_nonzero(disparity.measured)
    for numbers in ({"focal": 80.0}, {"baseline": 0.2}, {"calibration": "calib.txt", "focal": 80.0, "baseline": 0.2}):
        refused(depthcli.ConfigError, disparity.to_depth, **numbers)


def test_the_same_image_in_other_forms(pair: Images):
    def values(left: NDArray[np.generic], right: NDArray[np.generic]) -> NDArray[np.float32]:
        return depthcli.stereo(left, right, 12, "fast").values

    expected = values(*pair)
    frozen = [image.copy() for image in pair]
    for image in frozen:
        image.flags.writeable = False
    for same in (frozen, map(np.asfortranarray, pair), (np.dstack([image, image[..., 0]]) for image in pair)):
        assert np.array_equal(values(*same), expected)
    deep = [image.astype(np.uint16) * np.uint16(257) for image in pair]  # luma of 16 bits is rounded otherwise
    expected = values(*deep)
    assert np.array_equal(values(*(image.astype(">u2") for image in deep)), expected)
    assert np.array_equal(values(*(image / 255 for image in pair)), expected)
    scaled = depthcli.stereo(*(image.astype(np.uint16) * np.uint16(4) for image in pair), 12, "fast")
    told("\n".join(scaled.warnings))  # 10 bits
    np.testing.assert_allclose(scaled.values, values(*pair), atol=0.1)
    black = [image > 127 for image in pair]
    assert np.array_equal(values(*black), values(*(np.where(image, np.uint8(255), np.uint8(0)) for image in black)))


def test_overrides_are_those_of_set(pair: Images):
    plain = depthcli.load_config(depthcli.StereoConfig, "accurate")
    dotted = depthcli.load_config(depthcli.StereoConfig, "accurate", {"optimization.p2": 5})
    nested = depthcli.load_config(depthcli.StereoConfig, plain, optimization={"p2": np.float32(5)})
    assert dotted == nested != plain
    step = nested.pipeline.optimization  # type: ignore[attr-defined]
    assert depthcli.load_config(depthcli.StereoConfig, plain, optimization=step) == nested
    volume = depthcli.load_config(depthcli.FuseConfig, "consensus", measures=["census", {"volume": Path("net.npy")}])
    assert volume.volumes == {"net.npy"}
    whole = depthcli.load_config(depthcli.StereoConfig, plain, optimization={"method": "winner_takes_all"})
    assert whole.pipeline.optimization.method_name() == "winner_takes_all"  # type: ignore[attr-defined]
    given = depthcli.stereo(*pair, preset=plain, max_disparity=12)
    assert np.array_equal(given.values, depthcli.stereo(*pair, 12).values)


def test_wrong_configs_and_images_are_refused(pair: Images):
    for wrong in ({"preset": "acurate"}, {"tilez": "never"}, {"overrides": {"cost.": 1}}):
        with saying(depthcli.ConfigError):
            depthcli.stereo(*pair, **{"max_disparity": 12} | wrong)  # type: ignore[arg-type]
    with pytest.raises(depthcli.ConfigError, match=r"^device cuda:99: "):
        depthcli.stereo(*pair, 12, device="cuda:99")
    image = np.zeros((5, 6), np.uint8)
    for left, right in (
        (image, np.zeros((5, 7), np.uint8)), (image.astype(np.int32), image), (image, np.full((5, 6), 2.0)),
        (np.zeros((5, 6, 2), np.uint8), image), ("left.png", "right.png"),
    ):  # fmt: skip
        refused(depthcli.InputError, depthcli.stereo, left, right, 4, "fast")
    refused(depthcli.InputError, depthcli.stereo, np.zeros((40, 60), np.uint8), np.zeros((40, 60), np.uint8))
    for right in (pair[0], np.full_like(pair[0], 9)):
        told("\n".join(depthcli.stereo(pair[0], right, 12, "opencv-bm").warnings))


def test_the_pair_gives_a_range_that_is_not_given(pair: Images):
    found, requested = depthcli.stereo(*pair, preset="fast"), depthcli.stereo(*pair, "auto", "fast")
    assert found.search == requested.search and found.key_points["range_matches"] > 16
    assert len(found.warnings) == len(requested.warnings) + 1
    assert f'"auto" was taken, which gives {found.search.max_disparity} px' in found.warnings[-1]
    left = pair[0][..., 0]
    behind = np.hstack([np.roll(left, -4, axis=1)[:, :60], np.roll(left, 3, axis=1)[:, 60:]])  # there at -3 pixels
    found = depthcli.stereo(left, behind, "auto", "fast")
    low = found.key_points["range_low"]
    assert -8 <= low <= -3 and f"the images match at disparities down to {low}; " in found.warnings[-1]


def test_volumes_made_elsewhere(pair: Images):
    costs = np.random.default_rng(0).random((*pair[0].shape[:2], 13), np.float32)
    config = depthcli.FuseConfig.model_validate({"measures": ["census", {"volume": "net.npy"}], "max_disparity": 12})
    refused(depthcli.ConfigError, depthcli.fuse, *pair, preset=config)
    assert depthcli.fuse(*pair, preset=config, volumes={"net.npy": costs}).density == 1.0


@pytest.mark.parametrize("preset", ["fast", "opencv-sgbm-wls"])
def test_a_matcher_in_several_threads_gives_what_it_gives_alone(pair: Images, preset: str):
    match = depthcli.matcher(preset, max_disparity=12)
    pairs = [(np.roll(pair[0], k, axis=0), np.roll(pair[1], k, axis=0)) for k in range(4)]
    expected = [match(*each) for each in pairs]
    assert np.array_equal(expected[0].values, depthcli.stereo(*pair, 12, preset).values)
    wrong: list[int] = []

    def work() -> None:
        for k in (*range(4), *range(4)):
            found = match(*pairs[k])
            same = np.array_equal(found.values, expected[k].values, equal_nan=True)
            wrong.extend([] if same and np.array_equal(found.status, expected[k].status) else [k])

    in_threads([work] * 4)
    assert not wrong


def test_frames_back_to_back_take_no_more_memory(pair: Images):
    match, status = depthcli.matcher("fast", max_disparity=12), Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("no /proc here")

    def resident() -> int:
        return int(status.read_text("ascii").partition("VmRSS:")[2].split()[0])

    for _ in range(30):
        match(*pair)
    before, kept = resident(), memory.kept()
    for _ in range(200):
        match(*pair)
    assert resident() - before < 4000  # KiB; one frame leaves 100 KiB of maps
    assert memory.kept() <= kept + (1 << 20)
