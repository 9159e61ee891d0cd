# Photos of a board, and a scene, by two cameras that are turned against each other.
depthcli sample --output made --count 1 --kind foreground --quiet
python - <<'END'
from pathlib import Path

import cv2
import numpy as np

K = np.array([[420.0, 0, 199.5], [0, 420.0, 149.5], [0, 0, 1]])
turns = [cv2.Rodrigues(np.radians(angles))[0] for angles in ([0.6, 1.0, 0.5], [-0.5, -0.8, -0.6])]
baseline = np.array([0.12, 0, 0])
size, square, px = (400, 300), 0.025, 48
y, x = np.mgrid[:7, :10]
board = np.kron(np.where((x + y) % 2, 230, 25).astype(np.uint8), np.ones((px, px), np.uint8))
board = np.pad(board, px, constant_values=230)
to_board = np.diag([square / px, square / px, 1]) @ np.array([[1, 0, 0.5 - 2 * px], [0, 1, 0.5 - 2 * px], [0, 0, 1]])
rng = np.random.default_rng(0)
Path("photos").mkdir()
Path("scenes/desk").mkdir(parents=True)
for k in range(16):
    tilt = cv2.Rodrigues(np.radians(rng.uniform(-32, 32, 3) * (1, 1, 0.4)))[0]
    z = rng.uniform(0.5, 0.72)
    place = np.array([0.06 + rng.uniform(-0.12, 0.12) * z, rng.uniform(-0.1, 0.1) * z, z])
    place -= tilt @ [4 * square, 2.5 * square, 0]
    for side, turn, center in zip(("left", "right"), turns, (0 * baseline, baseline)):
        at = turn @ (place + (0.02 if k == 5 and side == "right" else 0) - center)
        H = K @ np.column_stack([(turn @ tilt)[:, 0], (turn @ tilt)[:, 1], at]) @ to_board
        fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
        image = cv2.warpPerspective(board, fine, (4 * size[0], 4 * size[1]), borderValue=120)
        cv2.imwrite(f"photos/{side}{k:02}.png", cv2.resize(image, size, interpolation=cv2.INTER_AREA))
for view, turn in zip(("left", "right"), turns):
    image = cv2.imread(f"made/foreground_0/{view}.png")
    image = cv2.warpPerspective(image, K @ turn @ np.linalg.inv(K), size, borderMode=cv2.BORDER_REFLECT)
    cv2.imwrite(f"scenes/desk/{view}.png", image)
END
