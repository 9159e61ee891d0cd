#!/usr/bin/env python3
"""Draw the README's picture, docs/static/overview.png, from a generated scene.

    scripts/make_overview.py [--kind foreground] [--seed 3]

Left image, disparity map of `stereo accurate`, its errors, and those of `stereo opencv-sgbm`.
"""

import subprocess
import tempfile
from pathlib import Path

import _env  # first: continues in the checkout's environment
import cv2
import matplotlib
import numpy as np
from _experiments import scenes_in

from depthcli.evaluation.protocols import headlines, picture
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.stereo_pairs import load_pair

OUTPUT = _env.ROOT / "docs" / "static" / "overview.png"
WIDTH, HEIGHT = 320, 240


def main() -> None:
    options = _env.options(__doc__, kind="foreground", seed=3)
    protocol = MiddleburyV2Protocol()
    with tempfile.TemporaryDirectory() as scratch:
        scenes = Path(scratch) / "scenes"
        look = ("--kind", options.kind, "--seed", options.seed, "--noise", 2, "--radiometric", 0.1)
        size = ("--width", WIDTH, "--height", HEIGHT)
        subprocess.run(_env.depthcli("sample", "--output", scenes, "--count", 1, *look, *size), check=True)
        (scene,) = scenes_in(scenes)
        left, truth = load_pair(scene).left, protocol.truth(scene)
        panels = [left]
        for preset in ("accurate", "opencv-sgbm"):
            words = ("stereo", preset, "--input", scenes, "--output", Path(scratch) / preset)
            subprocess.run(_env.depthcli(*words), check=True)
            estimate = read_disparity(Path(scratch) / preset / scene.name / "disp_left.pfm")
            if preset == "accurate":
                shown = matplotlib.colormaps["turbo"](estimate / np.nanmax(truth.values))[..., :3]
                panels.append((255 * shown).round().astype(np.uint8))
            panels.append(picture(protocol, estimate, truth))
            bad = headlines(protocol, estimate, truth)["nonocc"]
            print(f"{preset}: {bad:.2f} % of the visible pixels are off by more than 1 px")
    gap = np.full((HEIGHT, 6, 3), 255, np.uint8)
    strip = np.hstack([part for panel in panels for part in (panel, gap)][:-1])
    encoded = cv2.imencode(".png", strip[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    OUTPUT.write_bytes(encoded.tobytes())
    print(f"{OUTPUT}: {encoded.size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
