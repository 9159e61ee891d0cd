"""Refinement of a Kinect's depth map.

Gaps are filled and widened foreground is corrected; the status map says which pixel is which.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt
import numpy as np

import depthcli

size = "--width 240 --height 180 --frames 0 --seed 6"
subprocess.run(f"depthcli sample --kinect --output kinect/frames {size} --quiet".split(), check=True)
folder = "kinect/frames/foreground"
color = cv2.imread(f"{folder}/color.png")[..., ::-1]
depth, truth = (cv2.imread(f"{folder}/{name}.pfm", cv2.IMREAD_UNCHANGED) for name in ("depth", "depth_true"))

refined = depthcli.refine_depth(color, depth, "accurate")
status = np.select([refined.corrected, refined.filled, refined.kept], [3, 2, 1], 0)

depth_colors = plt.get_cmap("turbo_r").with_extremes(bad="black")  # black: no value
figure, axes = plt.subplots(2, 3, figsize=(11, 5.5), layout="constrained")
near, far = np.nanpercentile(truth, (1, 99))
axes[0, 0].imshow(color)
for axis, values in zip((axes[0, 1], axes[0, 2], axes[1, 0]), (depth, refined.values, truth), strict=True):
    axis.imshow(values, cmap=depth_colors, vmin=near, vmax=far)
axes[1, 1].imshow(status, cmap=plt.matplotlib.colors.ListedColormap(["k", "lightgray", "C0", "C3"]), vmin=0, vmax=3)
axes[1, 2].imshow(100 * np.abs(refined.values - truth), cmap="magma", vmin=0, vmax=10)
titles = (
    "color", "measured depth", "refined", "ground truth", "grey: kept, blue: filled, red: corrected", "error",
)  # fmt: skip
for axis, title in zip(axes.flat, titles, strict=True):
    axis.set(title=title, xticks=[], yticks=[])
figure.colorbar(axes[0, 2].images[0], ax=axes[0, :], label="depth, m")
figure.colorbar(axes[1, 2].images[0], ax=axes[1, :], label="error, cm")
plt.show()
