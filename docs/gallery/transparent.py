"""A transparent object.

The sensor sees through glass. A second, sparse depth map shows where, and fills the region.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt
import numpy as np

subprocess.run(["depthcli", "sample", "--transparent", "--output", "transparent/scenes", "--quiet"], check=True)
command = "depthcli transparent sparse --input transparent/scenes --output transparent/run --scenes glass_0"
subprocess.run(command.split(), check=True)


def read(name: str) -> np.ndarray:
    return cv2.imread(f"transparent/{name}", cv2.IMREAD_UNCHANGED)


truth = read("scenes/glass_0/depth_true.pfm")
sparse = np.argwhere(np.isfinite(read("scenes/glass_0/sparse.pfm")))
near, far = np.nanpercentile(truth, (1, 99))
depth_colors = plt.get_cmap("turbo_r").with_extremes(bad="black")  # black: no value
figure, axes = plt.subplots(2, 3, figsize=(11, 5.5), layout="constrained")
axes[0, 0].imshow(read("scenes/glass_0/color.png")[..., ::-1])
axes[0, 0].scatter(sparse[:, 1], sparse[:, 0], s=0.5, c="r")
for axis, name in ((axes[0, 1], "scenes/glass_0/depth.pfm"), (axes[0, 2], "run/glass_0/depth.pfm")):
    axis.imshow(read(name), cmap=depth_colors, vmin=near, vmax=far)
axes[1, 0].imshow(truth, cmap=depth_colors, vmin=near, vmax=far)
axes[1, 1].imshow(read("scenes/glass_0/mask_transparent.png"), cmap="gray")
axes[1, 2].imshow(read("run/glass_0/unreliable.png"), cmap="gray")
titles = ("color, sparse depth as dots", "sensor", "completed", "ground truth", "transparent", "unreliable.png")
for axis, title in zip(axes.flat, titles, strict=True):
    axis.set(title=title, xticks=[], yticks=[])
plt.show()
