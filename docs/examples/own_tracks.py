"""Feed the initializer with your own features and matches instead of images: here ORB features.

The initializer needs the pixel of each feature and a track id that is the same in all frames. You can use any features
and any matching. This example matches the ORB features of an image with those of the last second. Run it as
``python docs/examples/own_tracks.py [SOURCE]``.
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
from slam_init.types.frame import Frame
from slam_init.types.result import Result

#: A feature that is lost is searched in this number of frames: a second of video.
_MEMORY_FRAMES = 30
#: Lowe's ratio test: the distance of the best match must be below this share of the distance of the second best.
_RATIO = 0.8


class OrbTracks:
    """ORB features with track ids.

    * ``count``: Largest number of features per image.
    """

    def __init__(self, count: int = 1500) -> None:
        import cv2

        self._orb = cv2.ORB.create(count)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self._frames = 0
        self._next_id = 0
        # One row per track: its id, the frame in which it was last seen, and its descriptor in that frame.
        self._ids, self._seen = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._descriptors = np.zeros((0, 32), np.uint8)

    def track(self, gray: Image) -> tuple[Ints, Floats]:
        """Find the features of the next image and match them with the tracks.

        Shapes: ``gray`` (H, W), returns ``track_ids`` (N,), returns ``pixels`` (N, 2).
        """
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
        """Return the row of the track of each feature; -1 for a feature without a track."""
        row = np.full(len(descriptors), -1)
        if len(self._ids) < 2 or len(descriptors) < 2:
            return row
        distance = np.full(len(descriptors), np.inf)
        for best, second in self._matcher.knnMatch(descriptors, self._descriptors, k=2):
            if best.distance < _RATIO * second.distance:
                row[best.queryIdx], distance[best.queryIdx] = best.trainIdx, best.distance
        # If several features match one track, only the feature with the smallest distance keeps it.
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
    """Feed the initializer with ORB tracks until a map is found or the frames end."""
    initializer, tracks = Initializer(camera), OrbTracks()
    for frame in frames:
        ids, pixels = tracks.track(frame.gray)
        if initializer.process_tracks(ids, pixels, frame.timestamp_s):
            break
    return initializer.finish()


def main(argv: Sequence[str] | None = None) -> int:
    """Initialize from a source with ORB tracks and print the result.

    * ``argv``: The source (``synth:room`` by default); the arguments of the process by default.
    """
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
