"""Interlaced videos: two fields of one frame, seen at different times.

The even rows of an interlaced frame are half a frame interval older or younger than the odd rows. Where the image
moves, neighbouring rows differ more than rows two apart, which belong to the same field: a comb. In an image of one
time the mean absolute difference grows with the distance of the rows. For white noise, which has the least growth, the
two differences are equal. So a frame in which neighbouring rows differ by clearly more than rows two apart has two
fields. A flag of the container would tell less: progressive videos are often stored with it.

From the first such frame on, the odd rows are replaced by the means of the even rows beside them. The rows that are
left keep their places, so the calibration and earlier tracks stay valid; only the resolution of the columns is halved.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Image

#: Note for the user.
NOTE = "the video is interlaced: the rows of one field are used, the others are interpolated"

#: Frames with a larger comb ratio have two fields. White noise has the ratio 1, other images of one time have less. The
#: ratio of white noise is known to 0.5 % from 40,000 differences, the least that a 640 x 480 frame gives.
_LEAST_COMB = 1.1
#: Columns of a frame that are looked at: every eighth one.
_STEP = 8


def comb_ratio(image: Image) -> float:
    """Compute how much more neighbouring rows differ than rows two apart.

    Shapes: ``image`` (H, W).

    * Returns: Ratio of the mean absolute differences; 0 for an image without any.
    """
    if len(image) < 3:
        return 0.0
    # Of three channels the green one has most of the luminance.
    rows = (image if image.ndim == 2 else image[..., 1])[:, ::_STEP].astype(np.int16)
    near, far = (float(np.abs(rows[lag:] - rows[:-lag]).mean()) for lag in (1, 2))
    return near / far if far > 0 else 0.0


def first_field(image: Image) -> Image:
    """Replace the odd rows by the means of the even rows beside them.

    Shapes: ``image`` (H, W).
    """
    field = image.copy()
    between = field[1:-1:2]
    above, below = field[0:-2:2][: len(between)], field[2::2][: len(between)]
    field[1:-1:2] = ((above.astype(np.uint16) + below + 1) // 2).astype(np.uint8)
    if len(field) % 2 == 0 and len(field) > 1:  # the last row has no even row below
        field[-1] = field[-2]
    return field


class Deinterlacer:
    """Takes the frames of a video in order, and keeps one field of each from the first frame that has two.

    * ``found``: Whether a frame had two fields.
    """

    def __init__(self) -> None:
        self.found = False

    def process(self, image: Image) -> Image:
        """Return the frame as one instant shows it.

        Shapes: ``image`` (H, W).
        """
        self.found = self.found or comb_ratio(image) > _LEAST_COMB
        return first_field(image) if self.found else image
