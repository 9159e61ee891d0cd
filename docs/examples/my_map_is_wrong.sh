# A pair whose right camera is turned.
depthcli sample --output data --count 1 --kind planes --width 240 --height 180 --max-disparity 32 --quiet
mkdir tilted
cp data/planes_0/left.png tilted
python - <<'END'
import cv2

right = cv2.imread("data/planes_0/right.png")
turn = cv2.getRotationMatrix2D((120, 90), 2.5, 1) + [[0, 0, 0], [0, 0, 6]]
cv2.imwrite("tilted/right.png", cv2.warpAffine(right, turn, (240, 180), borderMode=cv2.BORDER_REPLICATE))
END
