#!/usr/bin/env python3
"""Draw the README's picture, docs/static/overview.png, from a generated scene.

    scripts/make_overview.py [--kind foreground] [--seed 3]

Left image, disparity map of `stereo accurate`, its errors, and those of `stereo opencv-sgbm`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import _env  # first: continues in the checkout's environment
import cv2
import matplotlib
import numpy as np

from depthcli.evaluation.protocols import headlines, picture
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.layouts.all_kinds import ALL_KINDS
from depthcli.io.stereo_pairs import load_pair
from depthcli.io.walk import discover_scenes

OUTPUT = _env.ROOT / "docs" / "static" / "overview.png"
WIDTH, HEIGHT = 320, 240
LIMIT = 300_000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="foreground", help="kind of scene (default: %(default)s)")
    parser.add_argument("--seed", default="3", help="seed of the scene (default: %(default)s)")
    options = parser.parse_args()
    protocol = MiddleburyV2Protocol()
    with tempfile.TemporaryDirectory() as scratch:
        scenes = Path(scratch) / "scenes"
        run("sample", "--output", scenes, "--count", "1", "--kind", options.kind, "--seed", options.seed,
            "--width", WIDTH, "--height", HEIGHT, "--noise", "2", "--radiometric", "0.1")  # fmt: skip
        (scene,) = discover_scenes(scenes, ALL_KINDS)
        left, truth = load_pair(scene).left, protocol.truth(scene)
        panels = [left]
        for preset in ("accurate", "opencv-sgbm"):
            run("stereo", preset, "--input", scenes, "--output", Path(scratch) / preset)
            estimate = read_disparity(Path(scratch) / preset / scene.name / "disp_left.pfm")
            if preset == "accurate":
                shown = matplotlib.colormaps["turbo"](estimate / np.nanmax(truth.disparity))[..., :3]
                panels.append((255 * shown).round().astype(np.uint8))
            panels.append(picture(protocol, estimate, truth))
            bad = headlines(protocol, estimate, truth)["nonocc"]
            print(f"{preset}: {bad:.2f} % of the visible pixels are off by more than 1 px")
    gap = np.full((HEIGHT, 6, 3), 255, np.uint8)
    strip = np.hstack([part for panel in panels for part in (panel, gap)][:-1])
    encoded = cv2.imencode(".png", strip[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    if encoded.size > LIMIT:
        print(f"{encoded.size} bytes are more than {LIMIT}", file=sys.stderr)
        return 1
    OUTPUT.write_bytes(encoded.tobytes())
    print(f"{OUTPUT}: {encoded.size / 1000:.0f} kB")
    return 0


def run(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "depthcli", *map(str, words), "--quiet"], check=True)


if __name__ == "__main__":
    sys.exit(main())
