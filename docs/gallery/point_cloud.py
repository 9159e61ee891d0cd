"""Point cloud of a rig.

Disparities become meters by focal length and baseline; the measured pixels become colored points.
"""

import subprocess

import matplotlib.pyplot as plt
import numpy as np


def run(command: str) -> None:
    subprocess.run(command.split(), check=True, stdout=subprocess.DEVNULL)


run("depthcli sample --real --output point_cloud/scenes --quiet")
run("depthcli stereo accurate --input point_cloud/scenes --output point_cloud/run")
run("depthcli depth point_cloud/run --output point_cloud/depth --ply --mask measured --far 5")

# A PLY file: a header in plain text, then x, y, z as float32 and three bytes of color for each point.
with open("point_cloud/depth/Motorcycle/points.ply", "rb") as file:
    header = list(iter(lambda: file.readline().decode().strip(), "end_header"))
    point = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("color", "u1", 3)]
    cloud = np.frombuffer(file.read(), point)
print(*header, sep="\n")

cloud = cloud[np.argsort(-cloud["z"])]  # near points are drawn last
color = cloud["color"] / 255
figure = plt.figure(figsize=(10, 4), layout="constrained")
seen = figure.add_subplot(1, 2, 1, projection="3d")
seen.scatter(cloud["x"], cloud["z"], -cloud["y"], c=color, s=0.5)
seen.view_init(elev=18, azim=-65)
seen.set(title="from the side", xlabel="x, m", ylabel="z, m", zlabel="-y, m", yticks=[2, 3, 4, 5])
above = figure.add_subplot(1, 2, 2)
above.scatter(cloud["x"], cloud["z"], c=color, s=0.5)
above.set(title="from above", xlabel="x, m", ylabel="z, m", aspect="equal")
plt.show()
