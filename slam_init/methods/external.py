"""An initializer that is an external program: it gets the frames as files, and writes a trajectory or nothing.

The program gets these files in a new folder, by the placeholders of its command
(:mod:`slam_init.methods.external_command`):

===========  ========================================================================================================
``{images}``  folder of the frames: ``000000.png``, ``000001.png``, ..., as stored (8 bit grey or BGR, not undistorted)
``{times}``   text file with a line ``timestamp filename`` for each frame, in seconds, as ``rgb.txt`` of TUM RGB-D
``{camera}``  the calibration, in the YAML of this project
``{out}``     empty folder for the results
``{count}``   number of frames
===========  ========================================================================================================

and may write these files to ``{out}``:

===================  ================================================================================================
``trajectory.txt``    ``timestamp tx ty tz qx qy qz qw``, world_from_cam, for the keyframes of its initial map
``frames_read.txt``   number of frames that the program had read when it had this map; without it all frames count
``reason.txt``        why there is no trajectory: one of :data:`slam_init.types.refusal.REASONS`
===================  ================================================================================================

A program that exits with 0 and writes no trajectory has no map. Any other end is an error of the program. A map from a
program has keyframes and no landmarks, so that nothing can be continued from it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.calibration.files import camera_yaml
from slam_init.config import Config
from slam_init.datasets.text import read_trajectory
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.methods.external_command import parse_external
from slam_init.methods.external_run import run_program
from slam_init.output.folder import writing
from slam_init.recording.recorder import Recorder
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.inertial import Gravity
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import REASONS, Verdict
from slam_init.types.result import Result
from slam_init.types.status import Status, frame_of

_TRAJECTORY, _FRAMES_READ, _REASON = "trajectory.txt", "frames_read.txt", "reason.txt"
#: Length of a number or of a reason.
_MAX_WORD_BYTES = 200
#: Kept length of the last line of the output of a program that failed.
_MAX_LINE = 300
#: Zlib level 1: higher levels take five times as long for a tenth of the size.
_PNG_COMPRESSION = 1


class ExternalInitializer(Initializer):
    """Takes frames, and runs the program at the end. There is no map before :meth:`finish`.

    * ``method``: ``command:PROGRAM ...``.
    * ``config``: With the limits of the program (:attr:`Config.external`).
    * ``recorder``: Receives each frame.
    * ``map``: The map of the program: keyframes without landmarks.
    * ``frames_read``: Number of frames that the program gets.
    * ``tracker``, ``history``: Not used by the program.
    """

    def __init__(self, method: str, camera: Camera, config: Config, recorder: Recorder | None = None) -> None:
        super().__init__(camera, config, recorder)
        self._command, self._limits = parse_external(method), config.external
        self._given: list[Observations] = []
        self._finished: Result | None = None
        with self._writing():
            self._temporary = tempfile.TemporaryDirectory(prefix="slam-init-external-", ignore_cleanup_errors=True)
            self._folder = Path(self._temporary.name)
            for name in ("images", "out"):
                (self._folder / name).mkdir()

    @property
    def result(self) -> Result:
        """Result up to now: before :meth:`finish`, that there is no map yet."""
        return super().result if self._finished is None else self._finished

    def process(
        self,
        image: Image | Frame,
        timestamp_s: float | None = None,
        *,
        mask: Image | None = None,
        gravity: Gravity | None = None,
        rotation: Floats | None = None,
        rotation_sigma_rad: float = 1e-3,
    ) -> Status:
        """Write the next frame to the folder of the program.

        Shapes: ``image`` (H, W).

        * Returns: Without a map. Frames beyond the limit of the configuration are not taken. A mask, gravity and a
          rotation are refused, since the program does not get them.
        """
        if not (mask is None and gravity is None and rotation is None):
            raise SlamInitError(f"{self._command.label} is an external program: give it no mask, gravity or rotation")
        import cv2

        if self._finished is not None or self.frames_read >= self._limits.max_frames:
            return self.status
        frame = frame_of(image, timestamp_s, self._given[-1].frame + 1 if self._given else 0, self.camera)
        given = _without_tracks(frame.index, frame.timestamp_s, frame.name)
        self.recorder.frame(frame, given)
        with self.stopwatch("write"), self._writing():
            _, encoded = cv2.imencode(".png", frame.image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_COMPRESSION])
            (self._folder / "images" / _file(self.frames_read)).write_bytes(encoded.tobytes())
        self._given.append(given)
        self._maps.count(frame.index)
        return self.status

    def process_tracks(self, *_: Any, **__: Any) -> Status:
        """Refuse tracks: an external program needs images."""
        raise SlamInitError(f"{self._command.label} is an external program, which needs images: give no points: source")

    def reset(self, since: int | None = None) -> None:
        """Refuse to restart: the program gets all frames at once."""
        raise SlamInitError("an external program gets all frames at once: it cannot restart after a loss")

    def finish(self) -> Result:
        """Run the program, and read its trajectory."""
        if self._finished is None:
            self._finished = self._run() if self.frames_read > 1 else self.result
        return self._finished

    def _run(self) -> Result:
        names = {"images": "images", "times": "times.txt", "camera": "camera.yaml", "out": "out"}
        values = {key: str(self._folder / name) for key, name in names.items()} | {"count": str(self.frames_read)}
        lines = [f"{given.timestamp_s:.9f} {_file(i)}\n" for i, given in enumerate(self._given)]
        try:
            with self._writing():
                Path(values["times"]).write_text("".join(lines), encoding="ascii")
                Path(values["camera"]).write_text(camera_yaml(self.camera), encoding="ascii")
                with self.stopwatch("program"):
                    words, limits = self._command.filled(values), self._limits
                    failure, output = run_program(words, limits.time_limit_s, limits.memory_limit_mb)
                if failure:
                    said = [line.strip() for line in output.splitlines() if line.strip()]
                    message = f": {said[-1][-_MAX_LINE:]}" if said else ", without a message"
                    raise SlamInitError(f"{self._command.label} {failure}{message}")
                return self._read(self._folder / "out")
        finally:
            self._temporary.cleanup()

    def _writing(self) -> AbstractContextManager[None]:
        return writing(f"the frames for {self._command.label}", "set TMPDIR")

    def _read(self, out: Path) -> Result:
        if not (out / _TRAJECTORY).exists():
            word = self._word(out, _REASON)
            return self._result(Verdict(word) if word in REASONS else Verdict.EXTERNAL_METHOD)
        label = self._command.label
        keyframes, unmatched = self._keyframes(read_trajectory(out / _TRAJECTORY, out))
        astray = f"{label}: {unmatched} poses of its trajectory have the time stamp of no frame"
        if len(keyframes) < 2:
            if unmatched:
                raise SlamInitError(f"{astray}: write those of {{times}}")
            return self._result(Verdict.EXTERNAL_METHOD)
        self._maps.accepted = _map_of(keyframes, self.camera)
        self.status = Status.initialized(None)
        notes = [f"{label}: an external program; its map has no landmarks"]
        notes += [f"{astray} and are left out"] if unmatched else []
        return self._result(None, self._frames_to_init(out, keyframes[-1].frame), tuple(notes))

    def _keyframes(self, trajectory: Trajectory | None) -> tuple[list[Keyframe], int]:
        """Match the poses with the frames by their time stamps; return the number of poses without a frame."""
        if trajectory is None:
            return [], 0
        stamps, found = np.array([given.timestamp_s for given in self._given]), trajectory.timestamps_s
        nearest = np.abs(stamps - found[:, None]).argmin(axis=1)
        # Half of a step: a program may round its stamps, and no stamp is then nearer to another frame.
        matched = np.abs(stamps[nearest] - found) < 0.5 * np.diff(stamps).min()
        positions, first = np.unique(nearest[matched], return_index=True)
        poses = [trajectory.world_from_cam[k] for k in np.flatnonzero(matched)[first]]
        keyframes = [
            Keyframe(given.frame, given.timestamp_s, given.name, poses[0].inverse() @ pose)
            for given, pose in zip((self._given[k] for k in positions), poses, strict=True)
        ]
        return keyframes, int((~matched).sum())

    def _frames_to_init(self, out: Path, last_frame: int) -> int:
        """The number of frames that the program says it has read; at least those up to its last keyframe."""
        word = self._word(out, _FRAMES_READ)
        if not word:
            return self.frames_read
        least = 1 + next(i for i, given in enumerate(self._given) if given.frame == last_frame)
        if not (word.isdecimal() and least <= int(word) <= self.frames_read):
            raise SlamInitError(
                f"{self._command.label}: {_FRAMES_READ} holds {word!r}: "
                f"write a number from {least} (its last keyframe) to {self.frames_read}"
            )
        return int(word)

    def _word(self, out: Path, name: str) -> str:
        if not (out / name).exists():
            return ""
        check_inside(out / name, out)
        return read_regular(out / name, _MAX_WORD_BYTES, "one word", SlamInitError).decode("ascii", "replace").strip()

    def _result(self, reason: Verdict | None, frames_to_init: int | None = None, notes: tuple[str, ...] = ()) -> Result:
        advice = "" if reason is None else reason.advice
        return replace(super().result, reason=reason, advice=advice, frames_to_init=frames_to_init, notes=notes)


def _file(position: int) -> str:
    return f"{position:06d}.png"


def _without_tracks(frame: int, timestamp_s: float, name: str) -> Observations:
    return Observations(frame, timestamp_s, name, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)))


def _map_of(keyframes: Sequence[Keyframe], camera: Camera) -> InitialMap:
    """A map of keyframes without landmarks."""
    newest = keyframes[-1]
    return InitialMap(
        keyframes=tuple(keyframes),
        pose_covariances=np.full((len(keyframes), 6, 6), np.nan),
        open_tracks=_without_tracks(newest.frame, newest.timestamp_s, newest.name),
        gauge="that of the external program",
        keyframes_before=tuple(keyframe.world_from_cam for keyframe in keyframes),
        camera=camera,
    )
