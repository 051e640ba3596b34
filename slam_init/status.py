"""What an initializer takes and tells, frame by frame: an image or a frame goes in, a status comes out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.reasons import ADVICE, Gate
from slam_init.types.result import Attempt

__all__ = ["INITIALIZED", "WAITING", "Status", "frame_of", "progress"]

WAITING, INITIALIZED = "waiting", "initialized"

#: What a pair has to pass, one after the other.
_STAGES = ("matches", "motion", "two views", "map")


@dataclass(frozen=True, eq=False)
class Status:
    """How far the initialization is. Truthy when there is a map.

    Attributes
    ----------
    state : str
        ``waiting`` or ``initialized``.
    progress : float
        0 at the start, 1 when initialized; between them how far the best pair came (:func:`progress`), of those whose
        reference frame is still a candidate. It falls when that frame is given up.
    reason : str or None
        Why there is no map yet, of the last attempt: one of :data:`slam_init.types.reasons.REASONS`; None when initialized.
    advice : str
        What the person who moves the camera should do; empty when initialized.
    attempt : Attempt or None
        What this frame led to: each gate with its value, its threshold and its advice, and the matches. None where
        nothing was tried.
    """

    state: str = WAITING
    progress: float = 0.0
    reason: str | None = "too_few_frames"
    advice: str = ADVICE["too_few_frames"]
    attempt: Attempt | None = None

    def __bool__(self) -> bool:
        return self.state == INITIALIZED

    def after(self, attempt: Attempt | None, progress: float) -> Status:
        """The status after a frame that did not lead to a map; reason and advice stay where nothing was tried."""
        if attempt is None:
            return replace(self, progress=progress, attempt=None)
        return Status(WAITING, progress, attempt.verdict, attempt.advice, attempt)

    @staticmethod
    def initialized(attempt: Attempt | None) -> Status:
        """The status once there is a map."""
        return Status(INITIALIZED, 1.0, None, "", attempt)


def progress(stage: str, gates: Iterable[Gate] = ()) -> float:
    """How far a pair came that was refused at a stage: 0 to 1, and 1 only for a map.

    There are four stages, a quarter each: enough matches; a motion that is more than a rotation; two views that agree
    on it and know its direction; a map that further views confirm. Within the stage counts how far the worst of its
    gates is: the ratio of value and threshold.

    Parameters
    ----------
    stage : str
        ``matches``, ``motion``, ``two views`` or ``map``.
    gates : iterable of Gate
        Of this stage; none where it was refused without a figure.
    """
    return (_STAGES.index(stage) + min((gate.fulfilled() for gate in gates), default=0.0)) / len(_STAGES)


def frame_of(image: Image | Frame, timestamp_s: float | None, index: int, camera: Camera) -> Frame:
    """An image as a frame with an index; a frame as it is.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, or Frame
        Grey or BGR.
    timestamp_s : float or None
        None: that of the frame, or the index for an image.
    index : int
        Of an image.
    camera : Camera
        Its size is that of the images.

    Raises
    ------
    SlamInitError
        Where the array is no such image, or the time stamp is not finite.
    """
    if timestamp_s is not None and not np.isfinite(timestamp_s):
        raise SlamInitError(f"time stamp {timestamp_s}: give seconds, or none")
    if isinstance(image, Frame):
        return image if timestamp_s is None else replace(image, timestamp_s=float(timestamp_s))
    size = (camera.height, camera.width)
    if image.dtype != np.uint8 or image.shape not in (size, (*size, 3)):
        raise SlamInitError(
            f"image of shape {image.shape} and type {image.dtype}: give uint8, {size} grey or {(*size, 3)} BGR, "
            "the size that the camera is calibrated for"
        )
    time_s = float(index) if timestamp_s is None else float(timestamp_s)
    return Frame(index, time_s, f"frame-{index:06d}", image)
