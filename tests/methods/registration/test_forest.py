"""Random forests: walked as scikit-learn walks them, the same bytes for a seed, and nothing but arrays in the file."""

from __future__ import annotations

import io
import sys
import zipfile

import numpy as np
import pytest

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.volumes import RegisteredPair
from depthcli.data.formats.forests import Forest, read_forest, write_forest
from depthcli.data.generated.deformed_volumes import make_deformed_pair
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.forest import check_forest, predict, train
from tests.naive import registration as naive

SETTINGS = {"radius": 3, "features": [{"method": "mind"}]}


def table(seed=0, rows=400):
    rng = np.random.default_rng(seed)
    columns = {name: rng.standard_normal(rows).astype(np.float32) for name in "abc"}
    return columns, (np.abs(columns["a"]) + 3 * (columns["b"] > 0)).astype(np.float32)


def stump(**changes):
    fields = {
        "measures": ("a", "b"), "settings": SETTINGS, "trained_on": ("x",), "roots": np.array([0], np.int32),
        "feature": np.array([1, -1, -1], np.int32), "threshold": np.array([0.5, 0, 0]),
        "left": np.array([1, 0, 0], np.int32), "right": np.array([2, 0, 0], np.int32),
        "value": np.array([0, 2, 7], np.float32),
    }  # fmt: skip
    return Forest(**{**fields, **changes})


def test_as_the_naive_twin():
    rng = np.random.default_rng(1)
    maps = {name: rng.standard_normal((3, 5, 7)).astype(np.float32) for name in "ab"}
    maps["b"][0, 0, 0] = 0.5  # on the threshold: left
    two = stump(
        roots=np.array([0, 3], np.int32), feature=np.array([1, -1, -1, 0, -1, 1, -1, -1], np.int32),
        threshold=np.array([0.5, 0, 0, -0.25, 0, 0, 0, 0]), left=np.array([1, 0, 0, 4, 0, 6, 0, 0], np.int32),
        right=np.array([2, 0, 0, 5, 0, 7, 0, 0], np.int32), value=np.array([0, 2, 7, 0, 1, 0, 4, 3], np.float32),
    )  # fmt: skip
    for forest in (stump(), two):
        found = predict(forest, maps)
        assert found.shape == (3, 5, 7) and found.dtype == np.float32
        np.testing.assert_allclose(found, naive.forest(forest, maps), rtol=1e-6)


def test_as_scikit_learn_and_the_same_at_any_number_of_jobs(tmp_path):
    ensemble = pytest.importorskip("sklearn.ensemble")
    columns, error = table()
    forest = train(columns, error, SETTINGS, ["x"], seed=4)
    model = ensemble.RandomForestRegressor(200, min_samples_leaf=3, max_features=1 / 3, random_state=4)
    rows = np.stack(list(columns.values()), axis=1)
    model.fit(rows, error)
    np.testing.assert_allclose(predict(forest, columns), model.predict(rows), rtol=1e-5)
    assert np.abs(predict(forest, table(1)[0]) - table(1)[1]).mean() < 0.3
    for name, other in (("one", forest), ("two", train(columns, error, SETTINGS, ["x"], seed=4, jobs=2))):
        write_forest(tmp_path / f"{name}.npz", other)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_a_file_holds_arrays_only_and_comes_back(tmp_path):
    write_forest(tmp_path / "f.npz", stump())
    with np.load(tmp_path / "f.npz", allow_pickle=False) as stored:
        assert all(stored[name].dtype != object for name in stored.files)
    back = read_forest(tmp_path / "f.npz")
    assert (back.measures, back.settings, back.trained_on) == (("a", "b"), SETTINGS, ("x",))
    assert all(np.array_equal(getattr(back, n), getattr(stump(), n)) for n in ("roots", "feature", "left", "value"))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (None, "no such file"),
        (b"PK nothing", "not a forest"),
        ({"left": np.array([0, 0, 0], np.int32)}, "branches"),  # a loop
        ({"right": np.array([9, 0, 0], np.int32)}, "branches"),
        ({"feature": np.array([2, -1, -1], np.int32)}, "branches"),
        ({"value": np.array([0, np.nan, 7], np.float32)}, "no numbers"),
        ({"value": np.zeros(2, np.float32)}, "differ in length"),
        ({"roots": np.zeros(0, np.int32)}, "differ in length"),
    ],
)
def test_damaged_files_are_one_line(tmp_path, spoil, said):
    file = tmp_path / "f.npz"
    if isinstance(spoil, bytes):
        file.write_bytes(spoil)
    elif spoil is not None:
        write_forest(file, stump(**spoil))
    with pytest.raises(InputError, match=said) as caught:
        read_forest(file)
    assert "f.npz" in str(caught.value) and "\n" not in str(caught.value)


def test_cut_and_pickled_files_are_refused(tmp_path):
    file = tmp_path / "f.npz"
    write_forest(file, stump())
    whole = file.read_bytes()
    for length in range(0, len(whole), 97):
        file.write_bytes(whole[:length])
        with pytest.raises(InputError):
            read_forest(file)
    stored = io.BytesIO()
    np.save(stored, np.array([{}], object), allow_pickle=True)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("head.npy", stored.getvalue())
    with pytest.raises(InputError, match="not a forest"):
        read_forest(file)


def test_what_it_was_trained_with_must_be_what_the_config_says():
    check_forest(stump(), {**SETTINGS, "more": 1}, ["b", "a", "c"])
    with pytest.raises(ConfigError, match="trained with radius: 3, the config says 4"):
        check_forest(stump(), {**SETTINGS, "radius": 4}, ["a", "b"])
    with pytest.raises(ConfigError, match="does not make: b"):
        check_forest(stump(), SETTINGS, ["a"])


def test_training_without_scikit_learn_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    with pytest.raises(ConfigError, match=r"pip install 'depthcli\[forest\]'"):
        train(*table(), SETTINGS, ["x"])


def test_learns_the_errors_of_other_pairs():
    pytest.importorskip("sklearn")
    method = RegisterConfidenceConfig(radius=4, half_window=2, stride=2)
    pairs, rows = [make_deformed_pair(seed, (32, 40, 40), 3.0, noise=40) for seed in (0, 1)], []
    volumes = [RegisteredPair(p.fixed, p.warped, (1.0, 1.0, 1.0), p.mask) for p in pairs]
    for pair, volume in zip(pairs, volumes, strict=True):
        maps, step, start = method.evidence(volume)
        assert list(maps) == method.measures_made() and step == (2, 2, 2) and start == (0, 0, 0)
        inside = pair.mask[::2, ::2, ::2]
        true = np.linalg.norm(pair.residual, axis=-1)[::2, ::2, ::2]
        rows.append(({name: values[inside] for name, values in maps.items()}, true[inside], inside, true))
    forest = train(*rows[0][:2], method.settings, ["0"])
    learned = method.model_copy(update={"calibration": "forest"})(volumes[1], forest).expected_error
    plain = method(volumes[1]).expected_error
    _, _, inside, true = rows[1]
    assert np.abs(learned - true)[inside].mean() < 0.6 * np.abs(plain - true)[inside].mean()
    with pytest.raises(ConfigError, match="radius: 4"):
        method.model_copy(update={"calibration": "forest", "radius": 3})(volumes[1], forest)
