# Single frames, a smaller depth map and a recording.
depthcli sample --kinect --width 240 --height 180 --frames 4 --output made --quiet
python - <<'END'
import shutil
from pathlib import Path

import cv2
import numpy as np


def millimeters(source, target, step=1):
    depth = cv2.imread(source, cv2.IMREAD_UNCHANGED)[::step, ::step]
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(target, np.where(np.isfinite(depth), np.rint(depth * 1000), 0).astype(np.uint16))


for target, step in (("frames/desk", 1), ("phone/desk", 4)):
    millimeters("made/foreground/depth.pfm", f"{target}/depth.png", step)
    shutil.copy("made/foreground/color.png", target)
Path("recording/walk/color").mkdir(parents=True)
for number in range(4):
    millimeters(f"made/moving/depth_{number:05}.pfm", f"recording/walk/depth/{number:05}.png")
    shutil.copy(f"made/moving/color_{number:05}.png", f"recording/walk/color/{number:05}.png")
END
