"""The worker processes of one machine, and what Ctrl-C does to them while they start."""

import signal
import subprocess
import sys

import pytest

_PRINTS_THE_MASK_OF_ITS_FIRST_PROCESS = """
import multiprocessing, signal
from depthcli.run.processes import _interrupts_blocked

def print_mask():
    print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))

if __name__ == "__main__":
    with _interrupts_blocked():
        process = multiprocessing.get_context("spawn").Process(target=print_mask)
        process.start()
        process.join()
    print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signal masks")
def test_the_first_worker_also_starts_with_interrupts_blocked(tmp_path):
    """It would answer Ctrl-C with a traceback of its imports; Python's resource tracker lifts the block once."""
    script = tmp_path / "script.py"
    script.write_text(_PRINTS_THE_MASK_OF_ITS_FIRST_PROCESS)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"], done.stderr
