"""Expected error of a registration.

A known smooth field displaces a volume. Estimate the error from both volumes alone, and compare it with the field.
"""

import cv2
import matplotlib.pyplot as plt
import numpy as np

import depthcli

z, y, x = np.mgrid[:32, :48, :48].astype(np.float32)
fixed = np.random.default_rng(0).standard_normal(x.shape)
for axis in range(3):  # smooth noise as texture
    fixed = np.apply_along_axis(np.convolve, axis, fixed, (0.1, 0.2, 0.4, 0.2, 0.1), mode="same")
fixed = fixed.astype(np.float32)
error = 4 * np.exp(-((x - 30) ** 2 + (y - 24) ** 2) / 150)  # along x, voxels of 1 mm
warped = np.stack([cv2.remap(fixed[k], x[k] + error[k], y[k], cv2.INTER_CUBIC) for k in range(len(fixed))])

found = depthcli.registration_confidence(fixed, warped, spacing=(1, 1, 1), preset="planes")
middle = len(fixed) // 2

figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
pair = np.stack([fixed, warped, warped], axis=-1)[middle]
axes[0].imshow(np.clip(1.5 * pair + 0.5, 0, 1))
axes[0].set(title="fixed (red) and warped (cyan)", xticks=[], yticks=[])
for axis, values, title in zip(axes[1:3], (error, found.values), ("true error", "expected error"), strict=True):
    drawn = axis.imshow(values[middle], cmap="turbo", vmin=0, vmax=5)
    axis.set(title=title, xticks=[], yticks=[])
figure.colorbar(drawn, ax=axes[1:3], label="mm")
axes[3].scatter(error[middle], found.values[middle], s=2)
axes[3].plot((0, 4), (0, 4), "k--")
axes[3].set(xlabel="true error, mm", ylabel="expected error, mm", aspect="equal")
plt.show()
