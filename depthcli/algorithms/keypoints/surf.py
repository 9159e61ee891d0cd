"""Upright SURF (Bay, Ess, Tuytelaars and Van Gool, CVIU 2008)."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.keypoints import Detector, KeyPoints
from depthcli.core.maps import Doubles, Floats, Image8
from depthcli.kernels.jit import empty, helper, jit, run_bands

_LAYERS = 4  # filter sizes of an octave, as in the paper


class Surf(Detector):
    """Detect blobs by box-filtered Hessians on integral images and describe them by Haar responses, without rotation.

    In a rectified pair the orientation of a point would only add noise. The 64 numbers of a descriptor are the sums of
    dx, |dx|, dy and |dy| over 4 x 4 overlapping cells (Agrawal, Konolige and Blas, ECCV 2008). If a point moves a
    little, these sums change less than sums over disjoint cells.
    """

    threshold: float = Field(5e-6, gt=0, le=1, description="smallest Hessian determinant, image values in [0, 1]")
    octaves: int = Field(2, ge=1, le=6, description="number of octaves (doublings of scale) that are searched")

    def __call__(self, image: Image8) -> KeyPoints:
        grey = np.ascontiguousarray(image, dtype=np.float32) / np.float32(255)
        # Zero mean keeps the sums small and their differences exact enough.
        integral = np.ascontiguousarray(cv2.integral(grey - grey.mean(), sdepth=cv2.CV_64F))
        points = np.concatenate([self._octave(integral, k) for k in range(self.octaves)])
        points = points[np.lexsort((points[:, 2], points[:, 0], points[:, 1], -points[:, 3]))]
        descriptors = np.zeros((len(points), 64), np.float32)
        if len(points):
            margin = 2 + int(13 * points[:, 2].max())  # boxes of a descriptor may extend beyond the image
            padded = np.pad(integral, margin, "edge")
            squares = np.arange(-4, 5) ** 2
            weights = np.exp((squares[:, None] + squares) / -12.5).astype(np.float32)  # in a cell
            run_bands(_describe, len(points), padded, margin, points, weights, descriptors)
        x, y, scale, response, sign = points.T.copy()
        return KeyPoints(x, y, scale, response, sign.astype(np.int8), descriptors)

    def _octave(self, integral: Doubles, octave: int) -> Floats:
        # Return the key points of one octave, (N, 5) float32: x, y, scale, response, sign.
        step = 1 << octave
        sizes = [3 * ((2 << octave) * (layer + 1) + 1) for layer in range(_LAYERS)]  # 9, 15, 21, 27 in octave 0
        height, width = integral.shape[0] - 1, integral.shape[1] - 1
        if min(height, width) < sizes[-1]:
            return np.zeros((0, 5), np.float32)
        responses = np.zeros((_LAYERS, -(-height // step), -(-width // step)), np.float32)
        signs = np.zeros(responses.shape, np.int8)
        for layer, size in enumerate(sizes):
            run_bands(_hessian, responses.shape[1], integral, step, size, responses[layer], signs[layer])
        peaks = np.zeros(responses.shape, np.bool_)
        run_bands(_find_peaks, responses.shape[1] - 2, responses, self.threshold, peaks)
        places = np.transpose(np.unravel_index(np.flatnonzero(peaks), peaks.shape))  # np.argwhere takes much longer
        return np.asarray(_located(responses, signs, places, step, sizes[0], sizes[1] - sizes[0]))


@helper
def _box(integral, y, x, height, width):
    # Sum of the pixels [y, y + height) x [x, x + width), which are inside. Unsigned indices save the wraparound.
    y0, x0, y1, x1 = np.uint64(y), np.uint64(x), np.uint64(y + height), np.uint64(x + width)
    return integral[y1, x1] - integral[y0, x1] - integral[y1, x0] + integral[y0, x0]


@jit
def _hessian(begin, end, integral, step, size, responses, signs):
    # Write the determinant of the box-filter Hessian, normalized by the filter's area; 0 if the filter does not fit.
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    lobe, half = size // 3, size // 2
    area = 1.0 / (size * size)
    for j in range(begin, end):
        y = j * step
        if y < half or y + half >= height:
            continue
        for i in range(-(-half // step), (width - half - 1) // step + 1):
            x = i * step
            dyy = _box(integral, y - half, x - lobe + 1, size, 2 * lobe - 1) - 3.0 * _box(
                integral, y - lobe // 2, x - lobe + 1, lobe, 2 * lobe - 1
            )
            dxx = _box(integral, y - lobe + 1, x - half, 2 * lobe - 1, size) - 3.0 * _box(
                integral, y - lobe + 1, x - lobe // 2, 2 * lobe - 1, lobe
            )
            dxy = (
                _box(integral, y - lobe, x + 1, lobe, lobe)
                + _box(integral, y + 1, x - lobe, lobe, lobe)
                - _box(integral, y - lobe, x - lobe, lobe, lobe)
                - _box(integral, y + 1, x + 1, lobe, lobe)
            )
            dxx, dyy, dxy = area * dxx, area * dyy, area * dxy
            # 0.9 squared: ratio of box filters to Gaussian derivatives (w of the paper).
            responses[j, i] = dxx * dyy - 0.81 * dxy * dxy
            signs[j, i] = 1 if dxx + dyy >= 0.0 else -1


@jit
def _find_peaks(begin, end, responses, threshold, peaks):
    # Select maxima over 3 x 3 x 3 cells.
    layers, _, columns = responses.shape
    for j in range(begin + 1, end + 1):
        for k in range(1, layers - 1):
            for i in range(1, columns - 1):
                peaks[k, j, i] = responses[k, j, i] >= threshold and _is_peak(responses, k, j, i)


@jit
def _located(responses, signs, peaks, step, first_size, size_step):
    # Return key points at the (N, 3) peaks, moved to the peak of the parabola through the cells around.
    points = empty((len(peaks), 5), np.float32)
    count = 0
    for k, j, i in peaks:
        dx, dy, dk = _offset(responses, k, j, i)
        if abs(dx) > 1.0 or abs(dy) > 1.0 or abs(dk) > 1.0:
            continue  # no peak here: a ridge
        points[count, 0] = (i + dx) * step
        points[count, 1] = (j + dy) * step
        points[count, 2] = 1.2 / 9.0 * (first_size + (k + dk) * size_step)
        points[count, 3] = responses[k, j, i]
        points[count, 4] = signs[k, j, i]
        count += 1
    return points[:count].copy()


@helper
def _is_peak(responses, k, j, i):
    value = responses[k, j, i]
    for dk in range(-1, 2):
        for dj in range(-1, 2):
            for di in range(-1, 2):
                other = responses[k + dk, j + dj, i + di]
                # If cells are equal, the first in memory is the peak.
                earlier = dk < 0 or (dk == 0 and (dj < 0 or (dj == 0 and di < 0)))
                if other > value or (other == value and earlier):
                    return False
    return True


@helper
def _offset(r, k, j, i):
    # Return the peak of the second-order Taylor polynomial around a cell, in cells; 9 if there is none.
    gx = 0.5 * (r[k, j, i + 1] - r[k, j, i - 1])
    gy = 0.5 * (r[k, j + 1, i] - r[k, j - 1, i])
    gk = 0.5 * (r[k + 1, j, i] - r[k - 1, j, i])
    center = 2.0 * r[k, j, i]
    xx = r[k, j, i + 1] + r[k, j, i - 1] - center
    yy = r[k, j + 1, i] + r[k, j - 1, i] - center
    kk = r[k + 1, j, i] + r[k - 1, j, i] - center
    xy = 0.25 * (r[k, j + 1, i + 1] - r[k, j + 1, i - 1] - r[k, j - 1, i + 1] + r[k, j - 1, i - 1])
    xk = 0.25 * (r[k + 1, j, i + 1] - r[k + 1, j, i - 1] - r[k - 1, j, i + 1] + r[k - 1, j, i - 1])
    yk = 0.25 * (r[k + 1, j + 1, i] - r[k + 1, j - 1, i] - r[k - 1, j + 1, i] + r[k - 1, j - 1, i])
    # Cramer's rule on the symmetric 3 x 3 system.
    a = yy * kk - yk * yk
    b = xk * yk - xy * kk
    c = xy * yk - xk * yy
    determinant = xx * a + xy * b + xk * c
    if abs(determinant) < 1e-30:
        return 9.0, 9.0, 9.0
    d = xx * kk - xk * xk
    e = xy * xk - xx * yk
    f = xx * yy - xy * xy
    dx = -(a * gx + b * gy + c * gk) / determinant
    dy = -(b * gx + d * gy + e * gk) / determinant
    dk = -(c * gx + e * gy + f * gk) / determinant
    return dx, dy, dk


@jit
def _describe(begin, end, integral, margin, points, weights, descriptors):
    # Write (N, 64) descriptors, from 24 x 24 Haar responses at the point's scale, in 4 x 4 cells of 9 x 9.
    for n in range(begin, end):
        cx, cy, scale = points[n, 0], points[n, 1], points[n, 2]
        half = max(1, int(np.floor(scale + 0.5)))
        horizontal = empty((24, 24), np.float32)
        vertical = empty((24, 24), np.float32)
        for j in range(24):
            y = margin + int(np.floor(cy + (j - 11.5) * scale + 0.5))
            for i in range(24):
                x = margin + int(np.floor(cx + (i - 11.5) * scale + 0.5))
                # Two halves of a square of side 2 s with its center on the pixel's corner.
                horizontal[j, i] = _box(integral, y - half, x, 2 * half, half) - _box(
                    integral, y - half, x - half, 2 * half, half
                )
                vertical[j, i] = _box(integral, y, x - half, half, 2 * half) - _box(
                    integral, y - half, x - half, half, 2 * half
                )
        out = descriptors[n]
        length = np.float32(0.0)
        for cell in range(16):
            top, left = cell // 4 * 5, cell % 4 * 5
            dx, dy, ax, ay = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for j in range(weights.shape[0]):  # unrolled with a constant, it would become slower code
                for i in range(weights.shape[1]):
                    h = weights[j, i] * horizontal[top + j, left + i]
                    v = weights[j, i] * vertical[top + j, left + i]
                    dx += h
                    dy += v
                    ax += abs(h)
                    ay += abs(v)
            # Cells far from the point have less weight.
            v, h = cell // 4 - 1.5, cell % 4 - 1.5
            weight = np.float32(np.exp((v * v + h * h) / -4.5))
            out[4 * cell] = weight * dx
            out[4 * cell + 1] = weight * ax
            out[4 * cell + 2] = weight * dy
            out[4 * cell + 3] = weight * ay
            length += weight * weight * (dx * dx + ax * ax + dy * dy + ay * ay)
        if length > 0.0:
            scale_to_one = np.float32(1.0) / np.sqrt(length)
            for i in range(64):
                out[i] *= scale_to_one
