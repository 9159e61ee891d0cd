"""The pool of work arrays: recycled, never shared."""

import gc
import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest

from depthcli.core import memory
from tests.command_line import in_threads

MEBI = 1 << 20


@pytest.fixture(autouse=True)
def _empty_pool() -> Iterator[None]:
    gc.collect()
    memory.release()
    yield
    memory.release()


def address(array):
    return array.__array_interface__["data"][0]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, bool])
@pytest.mark.parametrize("shape", [(), (0, 7, 9), (1 << 20,), (301, 203, 37)])
def test_shape_type_and_layout_are_those_of_numpy(shape, dtype):
    ours, numpys = memory.empty(shape, dtype), np.empty(shape, dtype)
    assert (ours.shape, ours.dtype, ours.nbytes) == (numpys.shape, numpys.dtype, numpys.nbytes)
    assert ours.flags.c_contiguous and ours.flags.writeable and ours.flags.aligned
    ours[...] = 1
    assert np.all(ours == 1)


def test_memory_is_used_again_once_the_last_view_is_gone():
    array = memory.empty((3, MEBI), np.uint8)
    place = address(array)
    view = array[1:, ::2].T
    view[...] = 7
    del array
    other = memory.empty((3, MEBI), np.uint8)
    assert not np.shares_memory(other, view)
    other[...] = 9
    assert np.all(view == 7)
    del view
    assert address(memory.empty((3 * MEBI,), np.uint8)) == place


def test_what_is_kept_is_bounded_and_can_be_given_back():
    for _ in range(2):
        arrays = [memory.empty((48 * MEBI,), np.uint8) for _ in range(12)]
        del arrays
    assert 0 < sum(block.size for block in memory._free) <= memory._MAX_FREE_BYTES
    memory.release()
    assert not memory._free


def test_arrays_alive_at_once_never_share_memory_in_any_order_and_thread():
    alive: list[tuple[int, np.ndarray]] = []  # of all threads, at their end
    wrong = []

    def work(thread: int) -> None:
        rng = np.random.default_rng(thread)
        own: list[tuple[int, np.ndarray]] = []
        for mark in range(400 * thread, 400 * thread + 400):
            if own and rng.random() < 0.45:
                old, array = own.pop(rng.integers(len(own)))
                if not np.all(array.reshape(-1)[:: array.size // 50] == old):
                    wrong.append(old)
            array = memory.empty((int(rng.integers(1, 5)), MEBI // 2), np.uint16)
            array[...] = mark
            own = [*own, (mark, array[:, 1:])][-5:]
        alive.extend(own)

    in_threads([partial(work, k) for k in range(8)])
    assert not wrong
    ends = sorted((address(a), address(a) + (a.shape[0] - 1) * a.strides[0] + a[0].nbytes) for _, a in alive)
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(ends))
