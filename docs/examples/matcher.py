"""OpenCV's semi-global matcher as a program: left, right, largest disparity, block size, file to write."""

import sys

import cv2
import numpy as np

left, right, largest, block, output = sys.argv[1:]
left, right = (cv2.imread(file, cv2.IMREAD_GRAYSCALE) for file in (left, right))
disparities = (int(largest) // 16 + 1) * 16
disparity = cv2.StereoSGBM_create(0, disparities, int(block), 200, 800).compute(left, right)
cv2.imwrite(output, disparity.astype(np.float32) / 16)
