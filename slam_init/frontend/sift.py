"""SIFT features of single images, and which of two images are the same point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Floats, Image, Ints

__all__ = ["SiftFeatures", "detect_sift", "first_per_cell", "match_descriptors"]


@dataclass(frozen=True, eq=False)
class SiftFeatures:
    """Keypoints of an image.

    Attributes
    ----------
    pixels : (N, 2) float
        Raw pixels; no two within the same pixel.
    descriptors : (N, 128) float32
        Of unit norm.
    """

    pixels: Floats
    descriptors: Floats


def detect_sift(gray: Image, limit: int) -> SiftFeatures:
    """The strongest SIFT keypoints of a grey image (H, W), at most ``limit`` of them."""
    import cv2

    keypoints, descriptors = cv2.SIFT.create(nfeatures=limit).detectAndCompute(gray, None)
    if not keypoints:
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128)))
    pixels = np.array([k.pt for k in keypoints], float)
    single = first_per_cell(pixels, 1.0)  # a keypoint with two orientations is listed twice
    # RootSIFT (Arandjelovic and Zisserman 2012): Hellinger distance between the histograms.
    roots = np.sqrt(descriptors[single] / np.maximum(descriptors[single].sum(axis=1, keepdims=True), 1e-9))
    return SiftFeatures(pixels[single], roots)


def match_descriptors(old: Floats, new: Floats, ratio: float) -> tuple[Ints, Ints]:
    """Mutual nearest neighbours of unit descriptors that pass Lowe's ratio test, as positions in old and new."""
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
    """Positions of the first point in each square cell of the image, ascending."""
    if len(pixels) == 0:
        return np.zeros(0, np.int64)
    _, first = np.unique(np.floor(pixels / cell_px).astype(np.int64), axis=0, return_index=True)
    return np.sort(first)
