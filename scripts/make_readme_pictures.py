#!/usr/bin/env python3
"""Make the README's picture from a generated scene: left image, true disparity, result, errors.

Runs ``depthcli sample`` and ``depthcli stereo`` as a user would, then writes one JPEG strip (some 40 kB) into a
folder of its own; the repository holds no generated pictures.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import _env  # noqa: F401  (first: continues in the checkout's environment)
import cv2
import numpy as np

from depthcli.data.formats.disparity import read_disparity
from depthcli.data.walk import discover_scenes
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="accurate", help="preset or config of the result (default: %(default)s)")
    parser.add_argument("--kind", default="curved", help="kind of scene (default: %(default)s)")
    parser.add_argument("--seed", default="1", help="seed of the scene (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("demo/pictures"), help="folder (default: %(default)s)")
    options = parser.parse_args()

    with tempfile.TemporaryDirectory() as scratch:
        scenes, run = Path(scratch) / "scenes", Path(scratch) / "run"
        for command in (
            ["sample", "--output", scenes, "--count", "1", "--kind", options.kind, "--seed", options.seed],
            ["stereo", options.preset, "--input", scenes, "--output", run],
        ):
            done = subprocess.run([sys.executable, "-m", "depthcli", *map(str, command)], check=False)
            if done.returncode:
                return done.returncode
        (scene,) = discover_scenes(scenes)
        left, truth = scene.load().left, MiddleburyV2Protocol().truth(scene)
        estimate = read_disparity(run / scene.name / "disp_left.pfm")
    assert scene.max_disparity is not None
    strip = np.hstack(
        [
            left,
            colored(truth.disparity, scene.max_disparity),
            colored(estimate, scene.max_disparity),
            MiddleburyV2Protocol().picture(estimate, truth),
        ]
    )
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / f"{options.preset}-{scene.name}.jpg"
    half = cv2.resize(strip, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), half[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    bad = MiddleburyV2Protocol().headlines(estimate, truth)["nonocc"]
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB, {bad:.2f} % of the visible pixels are off by more than 1 px")
    return 0


def colored(disparity: np.ndarray, top: int) -> np.ndarray:
    """Return (H, W, 3) uint8 RGB: near = red, far = blue, no value = black."""
    levels = np.nan_to_num(np.clip(disparity / top, 0, 1) * 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)[:, :, ::-1].copy()
    picture[np.isnan(disparity)] = 0
    return picture


if __name__ == "__main__":
    sys.exit(main())
