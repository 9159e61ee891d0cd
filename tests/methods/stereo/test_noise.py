"""Noise before matching: how it is measured, when it is averaged away, and what that is worth."""

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import n_threads
from depthcli.methods.stereo.adjustment import adjusted, noise
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import assert_pure
from tests.contracts.inputs import preset, views, wrong
from tests.scenes import real_pair, real_scenes


def smooth():
    """Soft blobs from 60 to 190, (200, 300)."""
    blobs = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(200, 300)), (0, 0), 12)
    return 125 + 65 * blobs / np.abs(blobs).max()


@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.0, 8.0])
def test_the_noise_is_measured(sigma):
    noisy = smooth() + np.random.default_rng(1).normal(0, sigma, (200, 300))
    found = [noise.noise_level(np.rint(noisy * scale).astype(np.float32)) for scale in (1, 257)]
    np.testing.assert_allclose([each[0] for each in found], (sigma, 257 * sigma), rtol=0.25)
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=0.15)


def dark(seed, kind="planes", sigma=1.5):
    return make_scene(kind, seed, 300, 220, 40, wall_contrast=0.6, brightness=0.08, noise=sigma)


@pytest.mark.parametrize(("size", "radii"), [(0.7, (3, 5)), (1.0, (5, 8)), (1.6, (9, 10))])
def test_noise_that_neighbors_share_is_seen_in_the_dark(size, radii):
    clean = smooth() / 25
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=clean.shape), (0, 0), size)
    level = np.rint(clean + 0.8 * grain / grain.std()).astype(np.float32)
    deviation, _, radius = noise.noise_level(level, differing=1.0)
    assert deviation == pytest.approx(0.8, rel=0.35)
    assert radii[0] <= radius <= radii[1]
    assert noise.noise_level(level)[2] == 3
    white = np.rint(clean + np.random.default_rng(1).normal(0, 0.8, clean.shape)).astype(np.float32)
    assert noise.noise_level(white, differing=1.0) == noise.noise_level(white)


@pytest.mark.parametrize("brightness", [0.05, 0.12])
def test_texture_in_the_dark_is_no_noise_since_both_views_have_it(brightness):
    pair = views(make_scene("planes", 3, 240, 180, 30, brightness=brightness))
    grains = np.random.default_rng(1).normal(size=(2, 180, 240))
    grains = [cv2.GaussianBlur(grain, (0, 0), 1) / 0.28 for grain in grains]
    noisy = (np.rint(image / 2 + 1.5 * g[..., None]).clip(0, 255) for image, g in zip(pair.color8, grains, strict=True))
    assert noise._differing(*map(noise._level, (pair.left, pair.right))) == 0
    assert noise._differing(*(noise._level(one.astype(np.uint8)) for one in noisy)) > 0.3


def grainy(scene, size, sigma=0.8, seed=1):
    """A scene's pair at 4 % of its brightness, in noise that neighbors share."""
    rng = np.random.default_rng(seed)
    views = []
    for image in (scene.left, scene.right):
        grain = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), size)
        views.append(np.rint(0.04 * image + sigma * grain / grain.std()).clip(0, 255).astype(np.uint8))
    return StereoPair(*views)


def test_whitening_leaves_noise_that_neighbors_do_not_share():
    texture = np.random.default_rng(0).normal(0, 0.5, (256, 320))
    texture[:96] = 0  # flat
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=texture.shape), (0, 0), 2.5)
    grain *= 1.5 / grain.std()
    levels = [np.rint(8 + texture + grain).astype(np.float32)]
    kernel, deviation = noise.whitening(levels)
    found = cv2.filter2D(levels[0] - 8, -1, kernel, borderType=cv2.BORDER_REFLECT)
    assert found.std() == pytest.approx(0.12, rel=0.1)
    assert found[20:76].std() == pytest.approx(deviation, rel=0.35)
    clean = cv2.filter2D(texture.astype(np.float32), -1, kernel, borderType=cv2.BORDER_REFLECT)
    before, after = (np.corrcoef(a.ravel(), texture.ravel())[0, 1] for a in (levels[0], found))
    assert before < 0.4 and after > 0.7 and clean.std() > 0.09
    shared = [np.corrcoef(a[20:76, 4:].ravel(), a[20:76, :-4].ravel())[0, 1] for a in (levels[0], found)]
    assert shared[0] > 0.4 and abs(shared[1]) < 0.2
    for unfit in (levels[0][:20], np.full((64, 64), 7, np.float32), np.rint(80 + 20 * texture + grain)):
        assert noise.whitening([unfit.astype(np.float32)]) is None


@pytest.mark.parametrize(("name", "ratio"), [("fast", 0.8), ("accurate", 0.75)])
def test_dark_scenes_in_coarse_noise_have_fewer_errors_than_averaged_and_than_sgbm(name, ratio, monkeypatch):
    pipeline, peer = (preset("stereo", one).pipeline for one in (name, "opencv-sgbm"))
    errors = np.zeros(3)
    for seed, kind, size in ((10, "planes", 2.0), (11, "foreground", 2.5), (12, "curved", 3.5)):
        scene = make_scene(kind, seed, 300, 220, 40)
        for k, (method, limit) in enumerate(((pipeline, noise._DIFFERING), (pipeline, 2), (peer, 2))):
            with monkeypatch.context() as patch:
                patch.setattr(noise, "_DIFFERING", limit)
                errors[k] += wrong(method(grainy(scene, size), scene.max_disparity), scene)
    assert errors[0] < ratio * errors[1:].min()


@pytest.mark.parametrize("kind", ["planes", "foreground"])
def test_a_clean_pair_stays_as_it_is(kind):
    pair = views(make_scene(kind, 3, 240, 180, 30))
    assert noise.denoised(pair) is pair
    assert adjusted(pair, 30, ("noise",)) is pair


def test_real_pairs_in_daylight_stay_as_they_are():
    assert noise.denoised(real_pair().pair) is real_pair().pair
    for folder in ("middlebury_v2", "middlebury_2001", "middlebury_2005"):
        for pair, _, _ in real_scenes(folder).values():
            assert noise.denoised(pair) is pair


def test_a_dark_pair_is_averaged_and_brightened():
    pair = views(dark(0))
    found = noise.denoised(pair)
    assert found.left.dtype == np.uint16 and found.bits is None and found.light_trust is None
    clean = make_scene("planes", 0, 300, 220, 40, wall_contrast=0.6)
    assert np.percentile(found.left.mean(2), 90) / 65535 == pytest.approx(0.55, abs=0.03)

    def unlikeness(image):  # to the scene in daylight, up to a curve of the levels
        given, true = (np.argsort(np.argsort(one.mean(2).ravel(), kind="stable")) for one in (image, clean.left))
        return 1 - np.corrcoef(given, true)[0, 1]

    assert unlikeness(found.left) < unlikeness(pair.left) / 2


@pytest.mark.parametrize("pair", [views(dark(2)), grainy(make_scene("planes", 2), 2.5)], ids=["white", "coarse"])
def test_strips_and_threads_do_not_show(pair, monkeypatch):
    found = []

    def run():
        cv2.setNumThreads(n_threads())
        found.append(noise.denoised(pair))
        return np.stack([found[-1].left, found[-1].right])

    assert_pure(run, pair.left, pair.right)
    monkeypatch.setattr(noise, "_STRIP", 50)
    difference = np.abs(noise.denoised(pair).left.astype(int) - found[0].left.astype(int))
    assert difference.max() <= 1  # sums that run down a column begin elsewhere


@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 40), (9, 3), (40, 5, 3)])
def test_tiny_and_flat_images(shape):
    for value in (0, 7, 255):
        image = np.full(shape, value, np.uint8)
        found = noise.denoised(StereoPair(image, image)).left
        assert np.ptp(found) == 0 and found.shape == shape


@pytest.mark.parametrize(("name", "ratio"), [("fast", 0.85), ("accurate", 0.7)])
def test_scenes_in_the_dark_have_fewer_errors(name, ratio):
    """Of the errors without the step."""
    pipeline = preset("stereo", name).pipeline
    without = pipeline.model_copy(update={"adjust": tuple(a for a in pipeline.adjust if a != "noise")})
    errors = np.zeros(2)
    for seed, kind in enumerate(("planes", "foreground", "curved")):
        scene = dark(10 + seed, kind)
        errors += [wrong(one(views(scene), scene.max_disparity), scene) for one in (pipeline, without)]
    assert errors[0] < ratio * errors[1]
