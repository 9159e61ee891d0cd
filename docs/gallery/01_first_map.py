"""
A disparity map
===============

Match two views of a generated scene: how far does each pixel move from one to the other?
"""

import subprocess

import cv2
import matplotlib.pyplot as plt

import depthcli

subprocess.run(["depthcli", "sample", "--output", "scenes", "-n", "1", "--quiet"], check=True)
left, right = (cv2.imread(f"scenes/planes_0/{side}.png")[..., ::-1] for side in ("left", "right"))

disparity = depthcli.stereo(left, right, max_disparity=48, preset="accurate")

figure, axes = plt.subplots(1, 3, figsize=(11, 3), layout="constrained")
axes[0].imshow(left)
axes[1].imshow(disparity.values, cmap="turbo")
axes[2].imshow(disparity.measured, cmap="gray")
for axis, title in zip(axes, ("left image", "disparity, pixels", "white: seen by both cameras"), strict=True):
    axis.set(title=title, xticks=[], yticks=[])
plt.show()
