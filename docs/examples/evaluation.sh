# A run, maps of two other programs, and folders that look like Middlebury's training scenes at quarter size.
depthcli sample --output scenes --count 8 --width 240 --height 180 --max-disparity 32 --quiet
depthcli sample --output made --count 15 --width 700 --height 100 --max-disparity 32 --kind planes --quiet
depthcli stereo fast --input scenes --output runs/fast --quiet
depthcli stereo accurate --input scenes --output runs/accurate --quiet
python - <<'END'
from pathlib import Path

import cv2
import numpy as np

for name in ("ours", "sgm"):
    Path("nets", name).mkdir(parents=True)
for scene in sorted(Path("scenes").glob("*_*")):
    left, right = (cv2.imread(str(scene / f"{view}.png"), 0) for view in ("left", "right"))
    disparity = cv2.StereoSGBM_create(0, 32, 5, 200, 800).compute(left, right).astype(np.float32) / 16
    cv2.imwrite(f"nets/sgm/{scene.name}.tiff", np.where(disparity > 0, disparity, np.nan))
    codes = cv2.imread(f"runs/accurate/{scene.name}/disp_left.png", cv2.IMREAD_UNCHANGED)
    cv2.imwrite(f"nets/ours/{scene.name}.png", cv2.GaussianBlur(codes, (0, 0), 1.0))
names = (
    "Adirondack ArtL Jadeplant Motorcycle MotorcycleE Piano PianoL Pipes Playroom Playtable PlaytableP Recycle Shelves "
    "Teddy Vintage"
)
for number, name in enumerate(names.split()):
    folder = Path("middlebury/trainingQ", name)
    folder.mkdir(parents=True)
    width = {"ArtL": 347, "Teddy": 450}.get(name, 700)
    for source, target in (("left", "im0"), ("right", "im1")):
        cv2.imwrite(f"{folder}/{target}.png", cv2.imread(f"made/planes_{number}/{source}.png")[:, :width])
    camera = "[700 0 350; 0 700 50; 0 0 1]"
    numbers = f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=100\nwidth={width}\nheight=100\nndisp=33\n"
    (folder / "calib.txt").write_text(numbers)
END
