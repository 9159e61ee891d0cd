"""Pictures of the scripts in docs/gallery, which are run for them."""

import contextlib
import functools
import io
import os
import runpy
from pathlib import Path
from tempfile import mkdtemp
from unittest import mock

import matplotlib.pyplot as plt
import numpy as np
from _docs_examples import environment
from pictures import SCRATCH, Shown, picture
from PIL import Image

DPI = 130


def drawn_by(script: Path) -> Shown:
    """Return the figure that a script shows."""
    here, folder, image = Path.cwd(), Path(mkdtemp(dir=SCRATCH.name)), io.BytesIO()
    silent = contextlib.redirect_stdout(io.StringIO())
    try:
        os.chdir(folder)
        with mock.patch.dict(os.environ, environment(folder)), mock.patch.object(plt, "show"), silent:
            runpy.run_path(str(script))
    finally:
        os.chdir(here)
    plt.gcf().savefig(image, dpi=DPI)
    plt.close("all")
    return np.asarray(Image.open(image).convert("RGB"))


for script in sorted((Path(__file__).resolve().parents[1] / "gallery").glob("*.py")):
    draw = functools.partial(drawn_by, script)
    functools.update_wrapper(draw, drawn_by).__name__ = f"gallery_{script.stem}"
    picture(draw)
