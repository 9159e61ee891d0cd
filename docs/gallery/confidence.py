"""Confidence and the sparsification curve.

A good confidence measure is low at wrong pixels, so that fewer of the surest pixels are wrong.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt
import numpy as np

import depthcli

size = "--width 240 --height 180 --max-disparity 32 --noise 6"
command = f"depthcli sample --output confidence/scenes --count 1 --kind foreground {size} --quiet"
subprocess.run(command.split(), check=True)
folder = "confidence/scenes/foreground_0"
left, right = (cv2.imread(f"{folder}/{side}.png")[..., ::-1] for side in ("left", "right"))
truth = cv2.imread(f"{folder}/disp_left.pfm", cv2.IMREAD_UNCHANGED)

names = ("pkrn", "lrd", "da")
found = depthcli.stereo(left, right, 32, "fast", confidence=names, refinement=[])  # no check, no filling
wrong = ~(np.abs(found.values - truth) <= 1)

figure, axes = plt.subplots(1, 3, figsize=(11, 3), layout="constrained")
axes[0].imshow(wrong, cmap="gray_r")
axes[0].set(title="black: wrong by more than 1 pixel", xticks=[], yticks=[])
axes[1].imshow(found.confidence["da"], cmap="viridis")
axes[1].set(title="confidence da", xticks=[], yticks=[])
kept = np.arange(1, wrong.size + 1) / wrong.size
for name in names:
    order = np.argsort(-found.confidence[name], axis=None, kind="stable")  # the surest pixels first
    axes[2].plot(100 * kept, 100 * np.cumsum(wrong.flat[order]) / np.arange(1, wrong.size + 1), label=name)
best = np.sort(wrong, axis=None)
axes[2].plot(100 * kept, 100 * np.cumsum(best) / np.arange(1, wrong.size + 1), "k--", label="best possible")
axes[2].set(xlabel="surest pixels kept, %", ylabel="wrong among them, %", ylim=(0, None))
axes[2].legend()
plt.show()
