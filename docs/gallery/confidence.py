"""Confidence and the sparsification curve.

A good confidence measure is low at incorrect pixels, so that few of the most certain pixels are incorrect.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt
import numpy as np

import depthcli

subprocess.run(["depthcli", "sample", "--real", "--output", "confidence/scenes", "--quiet"], check=True)
folder = "confidence/scenes/Motorcycle"
left, right = (cv2.imread(f"{folder}/{side}.png")[..., ::-1] for side in ("left", "right"))
truth = cv2.imread(f"{folder}/disp_left.pfm", cv2.IMREAD_UNCHANGED)

names = ("pkrn", "lrd", "da")
found = depthcli.stereo(left, right, 70, "fast", confidence=names, refinement=[])  # no check, no filling
known = np.isfinite(truth)
incorrect = known & ~(np.abs(found.values - truth) <= 1)
wrong = incorrect[known]

figure, axes = plt.subplots(1, 3, figsize=(11, 3), layout="constrained")
axes[0].imshow(incorrect, cmap="gray_r")
axes[0].set(title="black: off by more than 1 pixel", xticks=[], yticks=[])
shown = axes[1].imshow(found.confidence["da"], cmap="viridis")
axes[1].set(title="confidence da", xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[1], label="share of agreeing neighbors", shrink=0.8)
kept = np.arange(1, wrong.size + 1) / wrong.size
for name in names:
    order = np.argsort(-found.confidence[name][known], kind="stable")  # the most certain pixels first
    axes[2].plot(100 * kept, 100 * np.cumsum(wrong[order]) / np.arange(1, wrong.size + 1), label=name)
best = np.sort(wrong)
axes[2].plot(100 * kept, 100 * np.cumsum(best) / np.arange(1, wrong.size + 1), "k--", label="best possible")
axes[2].set(xlabel="most certain pixels kept, %", ylabel="incorrect among them, %", ylim=(0, None))
axes[2].legend()
plt.show()
