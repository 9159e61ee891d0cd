"""A cost measure of your own.

One file with one class is a plug-in: with ``--plugin``, a config can name it.
"""

import subprocess
from pathlib import Path

import cv2
import matplotlib.pyplot as plt

Path("own_cost").mkdir(exist_ok=True)
Path("own_cost/squared_difference.py").write_text('''
import numpy as np
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.volume import CostVolume

class SquaredDifference(CostMeasure):
    """Squared difference of grey levels, truncated."""
    truncation: float = 900.0
    bytes_per_cost = 4  # float32

    def __call__(self, pair, n_disparities):
        left, right = (image.astype(np.float32) for image in pair.grey8)
        costs = np.full((*left.shape, n_disparities), 100, np.float32)  # outside the right image, too
        for d in range(n_disparities):
            costs[:, d:, d] = np.minimum((left[:, d:] - right[:, : left.shape[1] - d]) ** 2, self.truncation)
        return CostVolume(costs)
''')
subprocess.run(["depthcli", "sample", "--real", "--output", "own_cost/scenes", "--quiet"], check=True)
command = "depthcli stereo fast --input own_cost/scenes --plugin own_cost/squared_difference.py --output own_cost/run"
settings = "--set cost=squared_difference --set optimization.p1=100 --set optimization.p2=400 --evaluate"
print(subprocess.run(f"{command} {settings}".split(), check=True, capture_output=True, text=True).stdout)

figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
for axis, name in zip(axes, ("scenes/Motorcycle/left.png", "run/Motorcycle/preview.png"), strict=True):
    axis.imshow(cv2.imread(f"own_cost/{name}")[..., ::-1])
    axis.set(title=name, xticks=[], yticks=[])
plt.show()
