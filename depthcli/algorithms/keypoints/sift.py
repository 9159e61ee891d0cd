"""SIFT (Lowe, IJCV 2004), from OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.keypoints import Detector, KeyPoints
from depthcli.core.maps import Image8


class Sift(Detector):
    """OpenCV's SIFT, with orientation: the alternative to ``surf``."""

    contrast_threshold: float = Field(0.04, gt=0, le=1, description="smallest contrast of an extremum, OpenCV's unit")
    edge_threshold: float = Field(10.0, ge=1, le=1e4, description="largest ratio of the principal curvatures")

    def __call__(self, image: Image8) -> KeyPoints:
        sift = cv2.SIFT.create(contrastThreshold=self.contrast_threshold, edgeThreshold=self.edge_threshold)
        points, descriptors = sift.detectAndCompute(np.ascontiguousarray(image), None)
        table = np.array([(*p.pt, p.size / 2, p.response) for p in points], np.float32).reshape(-1, 4)
        vectors = np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors, np.float32)
        vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12).astype(np.float32)
        order = np.lexsort((table[:, 0], table[:, 1], -table[:, 3]))
        x, y, scale, response = table[order].T.copy()
        return KeyPoints(x, y, scale, response, np.zeros(len(order), np.int8), vectors[order])
