"""What an initializer takes and tells, frame by frame: an image or a frame goes in, a status comes out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.display import Described
from slam_init.types.frame import Frame
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

__all__ = ["State", "Status", "frame_of"]


class State(StrEnum):
    """State of an initializer."""

    WAITING = "waiting"
    INITIALIZED = "initialized"


@dataclass(frozen=True, eq=False, repr=False)
class Status(Described):
    """How far the initialization is. Truthy when there is a map.

    Attributes
    ----------
    state : State
        ``waiting`` or ``initialized``.
    progress : float
        0 at the start, 1 when initialized. Between them it tells how far the best pair came
        (:func:`slam_init.types.gates.progress`), of those whose reference frame is still a candidate. It falls when
        that frame is dropped.
    reason : Verdict or None
        Why there is no map yet: the verdict of the last attempt; None when initialized.
    advice : str
        What the person who moves the camera should do; empty when initialized.
    attempt : Attempt or None
        The attempt of this frame: each gate with its value, its threshold and its advice, and the matches. None where
        no pair was tried.
    """

    state: State = State.WAITING
    progress: float = 0.0
    reason: Verdict | None = Verdict.TOO_FEW_FRAMES
    advice: str = Verdict.TOO_FEW_FRAMES.advice
    attempt: Attempt | None = None

    def __bool__(self) -> bool:
        return self.state == State.INITIALIZED

    def after(self, attempt: Attempt | None, progress: float) -> Status:
        """The status after a frame that did not lead to a map.

        Parameters
        ----------
        attempt : Attempt or None
            Of this frame. Without one, reason and advice stay.
        progress : float

        Returns
        -------
        Status
        """
        if attempt is None:
            return replace(self, progress=progress, attempt=None)
        return Status(State.WAITING, progress, attempt.verdict, attempt.advice, attempt)

    @staticmethod
    def initialized(attempt: Attempt | None) -> Status:
        """The status once there is a map.

        Parameters
        ----------
        attempt : Attempt or None
            The accepted one.

        Returns
        -------
        Status
        """
        return Status(State.INITIALIZED, 1.0, None, "", attempt)

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        if self:
            return "initialized", [("attempt", str(self.attempt).split("\n")[0])] if self.attempt is not None else []
        facts = [("advice", self.advice)]
        if self.attempt is not None:
            facts += [("failed", str(gate)) for gate in self.attempt.failed_gates[:2]]
        return f"waiting, {self.progress:.0%}: {self.reason}", facts


def frame_of(image: Image | Frame, timestamp_s: float | None, index: int, camera: Camera) -> Frame:
    """Make a frame of an image; a frame is returned as it is.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, or Frame
        Grey or BGR.
    timestamp_s : float or None
        In seconds. None: the time stamp of the frame, or the index for an image.
    index : int
        Index of an image.
    camera : Camera
        Its size is that of the images.

    Returns
    -------
    Frame

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
