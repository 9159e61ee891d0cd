# Two photos that are not rectified.
depthcli sample --output made --count 2 --noise 2 --quiet
mkdir mine
python - <<'END'
import cv2

for view, angle, shift in (("left", 0.6, 2), ("right", -0.5, -3)):
    image = cv2.imread(f"made/foreground_0/{view}.png")
    turn = cv2.getRotationMatrix2D((200, 150), angle, 1.0)
    turn[1, 2] += shift
    photo = cv2.warpAffine(image, turn, image.shape[1::-1], borderMode=cv2.BORDER_REFLECT)
    cv2.imwrite(f"mine/{view}.jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, 95])
END
