"""Features and matches of your own in place of images: here ORB, matched with what the last second showed.

The initializer wants to know which feature of the world is seen where: a track id for each, the same in all frames. How
they are found is up to you. Run it as ``python -m slam_init.examples.own_tracks [SOURCE]``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

import numpy as np

from slam_init.datasets import open_source
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.types.arrays import Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.result import Result

__all__ = ["OrbTracks", "initialize_from_tracks", "main"]

#: A feature is looked for again over this many frames: a second of video.
_MEMORY_FRAMES = 30
#: Lowe's ratio: the best match must be this much nearer than the second best.
_RATIO = 0.8


class OrbTracks:
    """ORB features with track ids.

    Parameters
    ----------
    count : int
        Features an image.
    """

    def __init__(self, count: int = 1500) -> None:
        import cv2

        self._orb = cv2.ORB.create(count)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self._frames = 0
        self._next_id = 0
        # One row a track: its id, the frame that saw it last, and what it looked like there.
        self._ids, self._seen = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._descriptors = np.zeros((0, 32), np.uint8)

    def track(self, gray: Image) -> tuple[Ints, Floats]:
        """Track ids (N,) in ascending order and pixels (N, 2) of the features of the next image (H, W)."""
        keypoints, found = self._orb.detectAndCompute(gray, None)
        pixels = np.array([keypoint.pt for keypoint in keypoints], float).reshape(-1, 2)
        descriptors = np.zeros((0, 32), np.uint8) if found is None else np.asarray(found, np.uint8)
        row = self._match(descriptors)
        fresh = row < 0
        ids = np.where(fresh, self._next_id + np.cumsum(fresh) - 1, self._ids[row] if len(self._ids) else -1)
        self._next_id += int(fresh.sum())
        self._remember(ids, descriptors)
        order = np.argsort(ids)
        return ids[order], pixels[order]

    def _match(self, descriptors: Image) -> Ints:
        """The row of the track that each feature belongs to; -1 for none."""
        row = np.full(len(descriptors), -1)
        if len(self._ids) < 2 or len(descriptors) < 2:
            return row
        distance = np.full(len(descriptors), np.inf)
        for best, second in self._matcher.knnMatch(descriptors, self._descriptors, k=2):
            if best.distance < _RATIO * second.distance:
                row[best.queryIdx], distance[best.queryIdx] = best.trainIdx, best.distance
        # Of several features that claim one track the nearest gets it.
        by_distance = np.argsort(distance, kind="stable")
        _, first = np.unique(row[by_distance], return_index=True)
        losers = np.ones(len(row), bool)
        losers[by_distance[first]] = False
        row[losers] = -1
        return row

    def _remember(self, ids: Ints, descriptors: Image) -> None:
        kept = ~np.isin(self._ids, ids) & (self._seen > self._frames - _MEMORY_FRAMES)
        self._ids = np.concatenate([self._ids[kept], ids])
        self._seen = np.concatenate([self._seen[kept], np.full(len(ids), self._frames)])
        self._descriptors = np.concatenate([self._descriptors[kept], descriptors])
        self._frames += 1


def initialize_from_tracks(camera: Camera, frames: Iterable[Frame]) -> Result:
    """Feed the initializer with ORB tracks until there is a map, or no frame any more."""
    initializer, tracks = Initializer(camera), OrbTracks()
    for frame in frames:
        ids, pixels = tracks.track(frame.gray)
        bearings = camera.bearings(pixels)
        # A pixel beyond the field of view of the lens model has no ray.
        seen = np.isfinite(bearings).all(axis=1)
        observed = Observations(frame.index, frame.timestamp_s, frame.name, ids[seen], pixels[seen], bearings[seen])
        if initializer.process_tracks(observed):
            break
    return initializer.finish()


def main(argv: Sequence[str] | None = None) -> int:
    """Initialize from a source with ORB; exit codes as ``slam-init run``."""
    arguments = sys.argv[1:] if argv is None else argv
    try:
        source = open_source(arguments[0] if arguments else "synth:room")
        if source.camera is None:
            raise SlamInitError(f"{source.name} has no calibration: give a source with a camera.yaml")
        result = initialize_from_tracks(source.camera, source.frames())
    except SlamInitError as error:
        print(f"own_tracks: {error}", file=sys.stderr)
        return 2
    if result.map is None:
        print(f"not initialized: {result.reason}: {result.advice}")
        return 3
    print(f"initialized after {result.frames_to_init} frames: {len(result.map.points)} landmarks")
    return 0


if __name__ == "__main__":
    sys.exit(main())
