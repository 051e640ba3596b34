"""SIFT features of an image, and matches between the features of two images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_init.frontend.masking import Trackable
from slam_init.types.arrays import Floats, Image, Ints

#: Radius of the blob that makes a keypoint, over its diameter as OpenCV states it: OpenCV's diameter is two standard
#: deviations of the Gaussian, and the difference of Gaussians is zero beyond three.
_BLOB = 1.5
#: Least range of an image with keypoints, grey levels. A keypoint needs a difference of Gaussians of 255 * 0.04 / 3, by
#: the default of OpenCV. That of two Gaussians a third of an octave apart is at most 0.17 times the range, which has to
#: be 20. Half of this leaves room for the interpolation. SIFT takes as long on a black frame as on others.
_LEAST_RANGE = 10
#: Larger images are halved, as often as it takes: their smallest blobs are noise, and they have more than the limit. At
#: half the size, photographs of 2.5 megapixels have as many matches as before that keep to one epipolar geometry, in a
#: quarter of the time, and maps with more landmarks. Of 1.6 megapixels, they have .8 to 1.5 times as many, and one
#: sequence of three waits longer for its map; at 640x480 they have fewer in each of three sequences.
#: Class: measured.
_MOST_PIXELS = 1920 * 1080


class SiftFeatures(NamedTuple):
    """Keypoints of an image."""

    #: (N, 2) Raw pixels; at most one keypoint in each pixel.
    pixels: Floats
    #: (N, 128) RootSIFT descriptors of unit norm.
    descriptors: Floats


def detect_sift(gray: Image, limit: int, trackable: Trackable | None = None) -> SiftFeatures:
    """Detect the strongest SIFT keypoints of an image and describe them by RootSIFT [AZ12]_.

    .. [AZ12] R. Arandjelovic, A. Zisserman, "Three things everyone should know to improve object retrieval", CVPR 2012.

    Shapes: ``gray`` (H, W).
    """
    import cv2

    if int(gray.max()) - int(gray.min()) < _LEAST_RANGE:
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128)))
    scale = 1
    while gray.size > _MOST_PIXELS:
        # A coarse pixel is the mean of four, so that its centre lies between theirs.
        gray = np.asarray(cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        scale *= 2
    # Without the precise upscale, keypoints are off by a quarter of a pixel to the right and down.
    sift = cv2.SIFT.create(nfeatures=limit, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(gray, None)
    if not keypoints:
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128)))
    pixels = scale * (np.array([k.pt for k in keypoints], float) + 0.5) - 0.5
    if trackable is not None:
        clear = trackable.are_clear(pixels, _BLOB * scale * np.array([k.size for k in keypoints]))
        pixels, descriptors = pixels[clear], descriptors[clear]
    single = first_per_cell(pixels, 1.0)  # OpenCV lists a keypoint with two orientations twice
    # The Euclidean distance of the square roots is the Hellinger distance of the histograms.
    roots = np.sqrt(descriptors[single] / np.maximum(descriptors[single].sum(axis=1, keepdims=True), 1e-9))
    return SiftFeatures(pixels[single], roots)


def match_descriptors(old: Floats, new: Floats, ratio: float) -> tuple[Ints, Ints]:
    """Match descriptors that are mutual nearest neighbours and pass Lowe's ratio test.

    Shapes: ``old`` (N, D), ``new`` (M, D), returns ``i_old, i_new`` (K,).

    * ``ratio``: Largest distance of the nearest neighbour over that of the second nearest.
    * Returns ``i_old, i_new``: Positions of the matches in ``old`` and in ``new``; those in ``old`` ascend.
    """
    if len(old) < 2 or len(new) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    similarity = old.astype(np.float32) @ new.astype(np.float32).T
    best = np.argmax(similarity, axis=1)
    rows = np.arange(len(old))
    first = similarity[rows, best]
    mutual = np.argmax(similarity, axis=0)[best] == rows
    similarity[rows, best] = -np.inf
    second = similarity.max(axis=1)
    # |a - b|^2 = 2 - 2 a.b for unit vectors.
    passes = (2 - 2 * first) < ratio**2 * (2 - 2 * second)
    kept = np.flatnonzero(mutual & passes)
    return kept.astype(np.int64), best[kept].astype(np.int64)


def first_per_cell(pixels: Floats, cell_px: float) -> Ints:
    """Keep one point in each square cell of the image.

    Shapes: ``pixels`` (N, 2), returns (K,).

    * Returns: Ascending positions of the first point in each cell that is not empty.
    """
    if len(pixels) == 0:
        return np.zeros(0, np.int64)
    cells = np.floor(pixels / cell_px).astype(np.int64)
    cells -= cells.min(axis=0)
    numbers = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    positions = np.arange(len(pixels))
    # Of the positions that are written to one cell the last one stays. Cells without a point are never read.
    first = np.empty(numbers.max() + 1, np.int64)
    first[numbers[::-1]] = positions[::-1]
    return np.flatnonzero(first[numbers] == positions)
