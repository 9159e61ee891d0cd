"""
Two methods and their errors
============================

Two runs over the same scenes from the command line, and the error of each map against the truth.
"""

import subprocess

import cv2
import matplotlib.pyplot as plt

import depthcli


def run(command: str) -> str:
    return subprocess.run(command.split(), check=True, capture_output=True, text=True).stdout


size = "--width 240 --height 180 --max-disparity 32"
run(f"depthcli sample --output two_methods/scenes --count 2 {size} --quiet")
methods = ("opencv-bm", "accurate")
for method in methods:
    run(f"depthcli stereo {method} --input two_methods/scenes --output two_methods/{method}")
runs = " ".join(f"two_methods/{method}" for method in methods)
print(run(f"depthcli evaluate {runs} --truth two_methods/scenes --output two_methods/results"))

scene = "foreground_0"
truth = cv2.imread(f"two_methods/scenes/{scene}/disp_left.pfm", cv2.IMREAD_UNCHANGED)
figure, axes = plt.subplots(2, 2, figsize=(8, 6), layout="constrained")
for row, method in zip(axes, methods, strict=True):
    disparity = cv2.imread(f"two_methods/{method}/{scene}/disp_left.pfm", cv2.IMREAD_UNCHANGED)
    scores = depthcli.evaluate(disparity, truth)
    row[0].imshow(disparity, cmap="turbo", vmin=0, vmax=32)
    drawn = row[1].imshow(scores.error, cmap="magma", vmin=0, vmax=4)
    row[0].set(title=method, xticks=[], yticks=[])
    row[1].set(title=f"error; {scores.value('bad', 'all', 1.0):.1f} % above 1 pixel", xticks=[], yticks=[])
figure.colorbar(drawn, ax=axes[:, 1], label="pixels", shrink=0.6)
plt.show()
