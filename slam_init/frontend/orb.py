"""ORB descriptors of the landmarks of a map, for systems that find places again by them (ORB-SLAM, pySLAM).

What needs the images of a map's keyframes gets them from a :class:`FrameMemory`.

A landmark has the descriptor of the newest keyframe whose image is at hand: an image takes 10 ms, and this one sees
nearly all landmarks. The landmarks are corners
of the full image, so that their octave is 0. Their orientation is that of the intensity centroid [1]_, as in ORB: the
descriptor of such a corner is that of ORB's own detector at this place.

References
----------
.. [1] E. Rublee et al., ORB: an efficient alternative to SIFT or SURF, ICCV 2011.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from slam_init.types.arrays import Bools, Floats, Image
from slam_init.types.frame import Frame
from slam_init.types.initial_map import Descriptors, InitialMap

#: Bytes of a descriptor, and diameter of the patch of its orientation.
_BYTES, _PATCH = 32, 31


class FrameMemory(dict[int, Image]):
    """The grey images of the last frames, by absolute index.

    * ``max_bytes``: The oldest images are dropped beyond this. The newest one stays in any case.
    """

    def __init__(self, max_bytes: int) -> None:
        super().__init__()
        self._free = max_bytes

    def reading(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Give frames on, and remember their images."""
        for frame in frames:
            self[frame.index] = frame.gray
            self._free -= frame.gray.nbytes
            while self._free < 0 and len(self) > 1:
                self._free += self.pop(next(iter(self))).nbytes
            yield frame


def describe_landmarks(map_: InitialMap, images: Mapping[int, Image]) -> Descriptors:
    """Compute the descriptors of the landmarks.

    Shapes: ``images`` (H, W).

    * ``images``: Grey images by absolute index; those of other frames are ignored.
    """
    descriptors = np.zeros((len(map_.points), _BYTES), np.uint8)
    described = np.zeros(len(map_.points), bool)
    for k in reversed(range(len(map_.keyframes))):
        image, rows = images.get(map_.keyframes[k].frame), np.flatnonzero(map_.observation_keyframes == k)
        if image is None or not len(rows):
            continue
        found, known = orb_descriptors(image, map_.observation_pixels[rows])
        landmarks = map_.observation_landmarks[rows[known]]
        descriptors[landmarks], described[landmarks] = found[known], True
        break
    return Descriptors(descriptors, described)


def orb_descriptors(image: Image, pixels: Floats) -> tuple[Image, Bools]:
    """Compute ORB descriptors at given pixels of an image.

    Shapes: ``image`` (H, W), ``pixels`` (N, 2), returns ``descriptors`` (N, 32), returns ``known`` (N,).

    * Returns ``known``: False for pixels on the border of the image. Near it, the image is mirrored.
    """
    import cv2

    orb = cv2.ORB.create(nlevels=1, edgeThreshold=1, patchSize=_PATCH)
    angles = orientations(image, pixels)
    points = [
        cv2.KeyPoint(float(x), float(y), float(_PATCH), float(angle), 0.0, 0, i)
        for i, ((x, y), angle) in enumerate(zip(pixels, angles, strict=True))
    ]
    kept, found = orb.compute(image, points)
    descriptors, known = np.zeros((len(pixels), _BYTES), np.uint8), np.zeros(len(pixels), bool)
    if kept:
        rows = [point.class_id for point in kept]
        descriptors[rows], known[rows] = found, True
    return descriptors, known


def orientations(image: Image, pixels: Floats) -> Floats:
    """Compute the angles in degrees from each pixel to the centroid of the intensities in a disc about it.

    Shapes: ``image`` (H, W), ``pixels`` (N, 2), returns (N,).
    """
    half = _PATCH // 2
    padded = np.pad(image, half + 1, mode="reflect")
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    y, x = (offsets[np.hypot(x, y) <= half + 0.5] for offsets in (y, x))
    size = (image.shape[1] - 1, image.shape[0] - 1)
    column, row = np.clip(np.round(pixels).astype(int), 0, size).T + half + 1
    patch = padded[row[:, None] + y, column[:, None] + x].astype(np.float32)  # exact: all sums are below 2^24
    return np.asarray(np.degrees(np.arctan2(patch @ y, patch @ x)) % 360.0, float)
