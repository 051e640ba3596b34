"""Whether images without times are those of a video, by their steps.

A video moves on as it did: from step to step, the shift of its images changes by 0.1 to 0.9 % of their width (medians
of eight sequences at 10 to 30 Hz). Between photographs it changes by 3 to 11 % (five sets). Only in a video do the
steps tell how the camera turns while the rows of one image are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from slam_init.datasets.grey_levels import Pixels
from slam_init.types.arrays import Floats32

#: Number of triples of consecutive images that are looked at. With three instead of five, photographs of a fountain
#: are a video.
TRIPLES = 5
#: Largest change of a shift, as a share of the sides. Between those of videos and those of photographs.
_MOST_CHANGE = 0.02
#: Largest shift: a camera of 60 degrees at 30 Hz turns by 180 degrees in a second. Photographs of a panorama have even
#: steps too, and larger ones.
_MOST_SHIFT = 0.1
# The shift is that of coarse images.
_SIZE = (128, 96)


def steps_are_even(triples: Iterable[Sequence[Pixels]]) -> bool:
    """Tell whether consecutive images are those of a video.

    * ``triples``: Of consecutive images; without any there is no video.
    """
    import cv2

    window = cv2.createHanningWindow(_SIZE, cv2.CV_32F)
    shifts = np.array(
        [
            [cv2.phaseCorrelate(one, next_one, window)[0] for one, next_one in pairwise(map(_coarse, triple))]
            for triple in triples
        ]
    ).reshape(-1, 2, 2) / np.array(_SIZE)
    if not len(shifts):
        return False
    largest = np.median(np.linalg.norm(shifts, axis=2).max(axis=1))
    change = np.median(np.linalg.norm(shifts[:, 1] - shifts[:, 0], axis=1))
    return bool(largest <= _MOST_SHIFT and change <= _MOST_CHANGE)


def _coarse(image: Pixels) -> Floats32:
    import cv2

    coarse = np.asarray(cv2.resize(image, _SIZE, interpolation=cv2.INTER_AREA), np.float32)
    return coarse if coarse.ndim == 2 else coarse.mean(axis=2)
