"""The input and the output of an initializer for each frame: a frame made from an image, a status and a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from quest.display import Described
from slam_init.types.arrays import Floats, Image, as_number
from slam_init.types.camera import Camera
from slam_init.types.evidence import FreeFocal, WindowEvidence
from slam_init.types.frame import Frame, as_image
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt, stated_reason


class State(StrEnum):
    """State of an initializer."""

    WAITING = "waiting"
    INITIALIZED = "initialized"


class PoseKind(StrEnum):
    """What is known of a pose."""

    ROTATION = "rotation"
    PROVISIONAL = "provisional"
    MAP = "map"


@dataclass(frozen=True, eq=False)
class CameraPose:
    """The pose of the newest camera: enough to render or to stabilize with while the initialization goes on.

    Attributes
    ----------
    kind : PoseKind
        ``rotation``: the tracks show no translation, and points count as far away. ``provisional``: the best motion of
        the last window, which may still be wrong (:attr:`slam_init.types.status.Status.risk`). ``map``: located in
        the accepted map.
    cam_from_first : (3, 3) float
        Rotation from the axes of the first camera to those of this one. Where no tracks link a map to the first camera,
        as after a cut, ``reference`` is the first one.
    rotation_sigma_deg : float
        Standard deviation of the rotation where it is largest. For ``rotation`` it allows for the parallax that a
        rotation takes up, for ``provisional`` for competing motions. It does not know that a sideways motion before
        a distant plane looks like a rotation.
    centre : (3,) float or None
        Centre of this camera from that of ``reference``, in the axes of the first camera. Its unit is that of the map,
        or the baseline of the pair of the window; None for ``rotation``.
    direction_sigma_deg : float or None
        Standard deviation of the direction of the pair's baseline where it is largest.
    reference : int or None
        Absolute index of the frame whose centre is the origin.
    """

    kind: PoseKind
    cam_from_first: Floats
    rotation_sigma_deg: float
    centre: Floats | None = None
    direction_sigma_deg: float | None = None
    reference: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Status(Described):
    """The state of the initialization after a frame. Truthy when there is a map.

    Attributes
    ----------
    state : State
        ``waiting`` or ``initialized``.
    progress : float
        0 at the start, 1 when initialized. Until then it is the progress (:func:`slam_init.types.refusal.progress`) of
        the best pair whose reference frame is still a candidate. It falls when that frame is dropped.
    reason : Verdict or None
        Why there is no map yet: the verdict of the last attempt, or ``wrong_focal_length``; None when initialized.
    advice : str
        What the person who moves the camera should do; empty when initialized.
    attempt : Attempt or None
        The attempt of this frame: each gate with its value, its threshold and its advice, and the matches. None if no
        pair was tried.
    window : WindowEvidence or None
        What the joint estimate of the last evaluated window says: the risk that its map is wrong with the terms of the
        risk, and the standard deviations of rotation, direction and depth. It stays while no frame is evaluated; None
        before the first, and for methods that state no risk.
    wrong_focal : FreeFocal or None
        The focal length by the tracks alone, where they contradict the stated one: check the calibration.
    pose : CameraPose or None
        The pose of the newest camera from the first one: its rotation from the second frame on, and its centre where a
        motion is known. None for the first frame, where too few tracks go on, and for methods without a window.
    refining : bool
        Whether ``process`` still takes frames: they locate the camera in the accepted map, and improve the map. Once it
        is False the map does not change any more. ``Config.refine_frames`` says how long this lasts.
    lost_at : int or None
        Absolute index of the first frame in which the accepted map was lost, if it was lost while it grew.
    """

    state: State = State.WAITING
    progress: float = 0.0
    reason: Verdict | None = Verdict.TOO_FEW_FRAMES
    advice: str = Verdict.TOO_FEW_FRAMES.advice
    attempt: Attempt | None = None
    window: WindowEvidence | None = None
    wrong_focal: FreeFocal | None = None
    pose: CameraPose | None = None
    refining: bool = False
    lost_at: int | None = None

    @property
    def risk(self) -> float | None:
        """Probability that a map of the last evaluated window is wrong, by the model; None where none was evaluated.

        ``acceptance.max_risk`` bounds it. What no model has comes on top, as in ``map.risk``.
        """
        return None if self.window is None else self.window.risk

    def __bool__(self) -> bool:
        return self.state == State.INITIALIZED

    def after(self, attempt: Attempt | None, progress: float, wrong_focal: FreeFocal | None = None) -> Status:
        """Return the status after a frame that did not lead to a map.

        * ``attempt``: The attempt of this frame, with the advice that is shown. Without an attempt, reason and advice
          stay.
        * ``progress``: From 0 to 1.
        """
        if attempt is None:
            return replace(self, progress=progress, attempt=None)
        window = attempt.window or self.window
        reason = stated_reason(attempt.verdict, wrong_focal)
        return Status(State.WAITING, progress, reason, attempt.advice, attempt, window, wrong_focal)

    @staticmethod
    def initialized(attempt: Attempt | None) -> Status:
        """Return the status once there is a map, with the accepted attempt."""
        return Status(State.INITIALIZED, 1.0, None, "", attempt, None if attempt is None else attempt.window)

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        if self:
            return "initialized", [("attempt", str(self.attempt).split("\n")[0])] if self.attempt is not None else []
        facts = [("advice", self.advice)]
        if self.attempt is not None:
            facts += [("failed", str(gate)) for gate in self.attempt.failed_gates[:2]]
        return f"waiting, {self.progress:.0%}: {self.reason}", facts


def frame_of(
    image: Image | Frame, timestamp_s: float | None, index: int, camera: Camera, mask: Image | None = None
) -> Frame:
    """Make a frame from an image, which is checked. A frame is returned unchanged, but for a given time stamp or mask.

    Shapes: ``image`` (H, W), ``mask`` (H, W).

    * ``timestamp_s``: In seconds. If it is None, a frame keeps its own time stamp, and that of an image is its index.
    * ``mask``: Pixels that are 0 are ignored. By default a frame keeps its own mask.
    """
    time_s = None if timestamp_s is None else as_number(timestamp_s, "the time stamp", "finite seconds, or None")
    size = (camera.width, camera.height)
    if not isinstance(image, Frame):
        image = as_image(image, f"the image of frame {index}", size)
        return Frame(index, float(index) if time_s is None else time_s, f"frame-{index:06d}", image, mask)
    as_image(image.image, f"the image of frame {image.index}", size)
    given = {"timestamp_s": time_s, "mask": mask}
    changed: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    return replace(image, **changed) if changed else image
