"""
Sweep of a parameter
====================

Each value is a run. ``sweep.csv`` has one row per run, and ``runs`` has the maps.
"""

import csv
import subprocess

import cv2
import matplotlib.pyplot as plt

size = "--width 240 --height 180 --max-disparity 32 --noise 16 --count 2"
subprocess.run(f"depthcli sample --output sweep/scenes {size} --quiet".split(), check=True)
command = "depthcli sweep fast --over optimization.p2=10,30,120,480 --input sweep/scenes --output sweep/p2"
print(subprocess.run(command.split(), check=True, capture_output=True, text=True).stdout)

with open("sweep/p2/sweep.csv", newline="") as file:
    bad = {int(row["optimization.p2"]): float(row["bad 1"]) for row in csv.DictReader(file)}
values = sorted(bad)
figure, axes = plt.subplots(1, 3, figsize=(11, 3), layout="constrained")
axes[0].semilogx(values, [bad[value] for value in values], "o-")
axes[0].set(xlabel="optimization.p2", ylabel="wrong by more than 1 pixel, %", ylim=(0, None))
axes[0].set_xticks(values, values, minor=False)
for axis, value in zip(axes[1:], (values[0], values[-1]), strict=True):
    disparity = cv2.imread(f"sweep/p2/runs/p2={value}/foreground_0/disp_left.pfm", cv2.IMREAD_UNCHANGED)
    axis.imshow(disparity, cmap="turbo", vmin=0, vmax=32)
    axis.set(title=f"p2 = {value}", xticks=[], yticks=[])
plt.show()
