"""Kernels whose numbers are spread over threads."""

import os
from collections.abc import Iterator

import numpy as np
import pytest

from depthcli.kernels.jit import n_threads, run_bands, set_threads
from tests.command_line import in_threads
from tests.golden import refused


@pytest.fixture(params=[1, 2, 3, 16])
def _threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("depthcli.kernels.jit._threads.most", 16)
    before = n_threads()
    set_threads(request.param)
    assert n_threads() == request.param
    yield
    set_threads(before)


def square(begin: int, end: int, out: np.ndarray) -> None:
    for k in range(begin, end):
        out[k] += k * k


@pytest.mark.parametrize("count", [0, 1, 2, 5, 100])
@pytest.mark.usefixtures("_threads")
def test_every_number_is_in_one_band(count: int):
    out = np.zeros(count, np.int64)
    run_bands(square, count, out)
    assert out.tolist() == [k * k for k in range(count)]


@pytest.mark.usefixtures("_threads")
def test_many_threads_may_call_at_a_time_and_kernels_may_call_others():
    found = np.zeros((8, 40, 30), np.int64)

    def rows(begin: int, end: int, out: np.ndarray) -> None:
        for k in range(begin, end):
            run_bands(square, out.shape[1], out[k])

    in_threads([lambda k=k: run_bands(rows, 40, found[k]) for k in range(8)])
    assert (found == np.arange(30) ** 2).all()


@pytest.mark.usefixtures("_threads")
def test_an_error_in_any_band_reaches_the_caller():
    def refuse(begin: int, end: int) -> None:
        if end == 20:
            raise MemoryError("too large")

    refused(MemoryError, run_bands, refuse, 20)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs copies of this process")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.usefixtures("_threads")
def test_a_copy_of_this_process_has_threads_of_its_own():
    out = np.zeros(50, np.int64)
    run_bands(square, 50, out)
    child = os.fork()
    if child == 0:
        run_bands(square, 50, out)
        os._exit(0 if (out == 2 * np.arange(50) ** 2).all() else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
