import cv2
import matplotlib.pyplot as plt
import numpy as np


def scene(folder):
    names = ("left.png", "right.png", "disp_left.pfm", "mask_nonocc.png")
    left, right, truth, visible = (cv2.imread(f"{folder}/{name}", cv2.IMREAD_UNCHANGED) for name in names)
    return left[..., ::-1], right[..., ::-1], truth, visible > 0


def wrong(values, truth, pixels):
    return 100 * np.mean(~(np.abs(values - truth) <= 1)[pixels])


def row(file, maps, truth, pixels=None):
    size = (3.2 * len(maps), 2.7)
    figure, axes = plt.subplots(1, len(maps), figsize=size, layout="constrained")
    for axis, (title, values) in zip(axes, maps.items(), strict=True):
        counted = np.isfinite(values) if pixels is None else pixels
        share = f"{wrong(values, truth, counted):.1f} % wrong"
        axis.imshow(values, cmap="turbo", vmin=truth.min() - 3, vmax=truth.max())
        axis.set(xticks=[], yticks=[])
        axis.set_title(f"{title}\n{share}", fontsize=10)
    figure.savefig(file, dpi=90)
    plt.close(figure)
