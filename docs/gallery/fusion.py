"""Fusion of measures.

One matching cost, four with equal weights, and four fused by consensus, in which the measures of a pixel vote.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt
import numpy as np

import depthcli

subprocess.run(["depthcli", "sample", "--real", "--output", "fusion/scenes", "--quiet"], check=True)
folder = "fusion/scenes/Motorcycle"
left, right = (cv2.imread(f"{folder}/{side}.png")[..., ::-1] for side in ("left", "right"))
truth = cv2.imread(f"{folder}/disp_left.pfm", cv2.IMREAD_UNCHANGED)
truth[~np.isfinite(truth)] = np.nan

maps = {
    "census alone": depthcli.fuse(left, right, 70, "thesis/ch6-confidences"),
    "four measures, equal weights": depthcli.fuse(left, right, 70, "thesis/ch6-equal"),
    "four measures, consensus": depthcli.fuse(left, right, 70, "consensus"),
}
figure, axes = plt.subplots(2, 3, figsize=(11, 5.5), layout="constrained")
for column, (name, disparity) in zip(axes.T, maps.items(), strict=True):
    scores = depthcli.evaluate(disparity, truth)
    top = column[0].imshow(disparity.values, cmap="turbo", vmin=7, vmax=60)
    column[0].set(title=name)
    bottom = column[1].imshow(scores.error, cmap="magma", vmin=0, vmax=4)
    column[1].set(title=f"error; {scores.value('bad', 'all', 1.0):.1f} % above 1 pixel")
    for axis in column:
        axis.set(xticks=[], yticks=[])
figure.colorbar(top, ax=axes[0], label="disparity, px")
figure.colorbar(bottom, ax=axes[1], label="error, px")
plt.show()
