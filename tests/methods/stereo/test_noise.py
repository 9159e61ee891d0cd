"""Noise before matching: how it is measured, when it is averaged away, and what that is worth."""

import itertools

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import n_threads
from depthcli.methods.stereo.adjustment import adjusted, noise
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import assert_pure, changed
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


def dark(seed, kind="planes"):
    return make_scene(kind, seed, 300, 220, 40, wall_contrast=0.6, brightness=0.08, noise=1.5)


def grainy(pair, size, sigma=0.8, brightness=0.04):
    """A pair at 4 % of its brightness, in noise that neighbors share."""
    rng = np.random.default_rng(1)

    def view(image):
        grain = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), size)
        return np.rint(brightness * image + sigma * grain / grain.std()).clip(0, 255).astype(np.uint8)

    return changed(pair, view)


@pytest.mark.parametrize(("size", "radii"), [(0.7, (3, 5)), (1.0, (5, 8)), (1.6, (9, 10))])
def test_noise_that_neighbors_share_is_seen_in_the_dark(size, radii):
    clean = smooth() / 25
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=clean.shape), (0, 0), size)
    level = np.rint(clean + 0.8 * grain / grain.std()).astype(np.float32)
    deviation, _, radius = noise.noise_level(level, differing=1.0)
    assert deviation == pytest.approx(0.8, rel=0.35) and radii[0] <= radius <= radii[1]
    assert noise.noise_level(level)[2] == 3
    white = np.rint(clean + np.random.default_rng(1).normal(0, 0.8, clean.shape)).astype(np.float32)
    assert noise.noise_level(white, differing=1.0) == noise.noise_level(white)


@pytest.mark.parametrize("brightness", [0.05, 0.12])
def test_texture_in_the_dark_is_no_noise_since_both_views_have_it(brightness):
    pair = views(make_scene("planes", 3, 240, 180, 30, brightness=brightness))
    noisy = grainy(pair, 1, 1.5, 0.5)
    assert noise._differing(*map(noise._level, (pair.left, pair.right))) == 0
    assert noise._differing(*map(noise._level, (noisy.left, noisy.right))) > 0.3


@pytest.mark.parametrize(("name", "ratio"), [("fast", 0.8), ("accurate", 0.75)])
def test_dark_scenes_in_coarse_noise_have_fewer_errors_than_averaged_and_than_sgbm(name, ratio, monkeypatch):
    pipeline, peer = (preset("stereo", one).pipeline for one in (name, "opencv-sgbm"))
    errors = np.zeros(3)
    for seed, kind, size in ((10, "planes", 2.0), (11, "foreground", 2.5), (12, "curved", 3.5)):
        scene = make_scene(kind, seed, 300, 220, 40)
        for k, (method, limit) in enumerate(((pipeline, noise._DIFFERING), (pipeline, 2), (peer, 2))):
            with monkeypatch.context() as patch:
                patch.setattr(noise, "_DIFFERING", limit)
                errors[k] += wrong(method(grainy(views(scene), size), scene.max_disparity), scene)
    assert errors[0] < ratio * errors[1:].min()


def test_clean_pairs_and_those_in_daylight_stay_as_they_are():
    for pair in (*(views(make_scene(kind, 3, 240, 180, 30)) for kind in ("planes", "foreground")), real_pair().pair):
        assert noise.denoised(pair) is pair and adjusted(pair, 30, ("noise",)) is pair
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


@pytest.mark.parametrize("pair", [views(dark(2)), grainy(views(make_scene("planes", 2)), 2.5)], ids=["white", "coarse"])
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


def test_tiny_and_flat_images():
    for shape, value in itertools.product([(1, 1, 3), (2, 40), (9, 3), (40, 5, 3)], (0, 7, 255)):
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
