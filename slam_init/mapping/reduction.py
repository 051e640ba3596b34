"""Large images are tracked at a reduced size, and their maps are given in original pixels.

The flow compares patches of 21 px and follows 80 px of motion; the thresholds in pixels are those of images of 640 to
1920 px. An image of 4K would show the same motion as three times as many pixels, with three times the blur, at nine
times the cost. So images whose longest side is :data:`TRACKED_SIDE` twice or more are reduced by a whole factor. Each
reduced pixel is then the mean of a square of original ones, and its place is exact. Smaller images are not touched,
nor those of lenses that gtsam has no calibration for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from slam_init.bundle.virtual_cameras import needs_virtual_cameras
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Result

#: Longest side of a reduced image, at least, in pixels: 3840 px become 1280, and 2560 become 1280.
TRACKED_SIDE = 1280


@dataclass(frozen=True)
class Reduction:
    """How the frames of a camera are reduced for tracking."""

    #: The camera of the frames.
    original: Camera
    #: Original pixels of a side over those of the reduced image. With 1 nothing is changed.
    factor: int
    #: The camera of the reduced frames.
    camera: Camera

    @classmethod
    def for_camera(cls, camera: Camera) -> Reduction:
        """Choose the reduction for a camera."""
        factor = max(1, max(camera.width, camera.height) // TRACKED_SIDE)
        if needs_virtual_cameras(camera):  # its factors measure no pixels that could be enlarged
            factor = 1
        if factor == 1:
            return cls(camera, 1, camera)
        # Rows and columns that do not fill a square at the right and lower border are left out.
        width, height = camera.width // factor, camera.height // factor
        return cls(camera, factor, replace(camera.scaled(1 / factor), width=width, height=height))

    @property
    def notes(self) -> tuple[str, ...]:
        """A note about the reduction."""
        if self.factor == 1:
            return ()
        return (
            f"tracked at {self.camera.width}x{self.camera.height}, each pixel the mean of {self.factor}x{self.factor}: "
            "the attempts have reduced pixels, the map has original ones",
        )

    def frames(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Reduce frames and their masks."""
        mask: Image | None = None
        reduced_mask: Image | None = None
        for frame in frames:
            if self.factor == 1:
                yield frame
                continue
            if frame.mask is not mask:  # one mask for all frames is reduced once
                mask, reduced_mask = frame.mask, None if frame.mask is None else self._mask(frame.mask)
            yield replace(frame, image=self._image(frame.image), mask=reduced_mask)

    def enlarged(self, result: Result) -> Result:
        """Give the maps of a result in original pixels."""
        if self.factor == 1:
            return result
        maps = {id(one): self._map(one) for one in (result.map, *result.hypotheses) if one is not None}
        if result.wrong_focal is not None:
            wrong = result.wrong_focal.enlarged(self.factor)
            before, text = result.wrong_focal.note, wrong.note
            notes = tuple(note.replace(before, text) for note in result.notes)
            result = replace(result, wrong_focal=wrong, notes=notes, advice=result.advice.replace(before, text))
        return replace(
            result,
            map=None if result.map is None else maps[id(result.map)],
            hypotheses=tuple(maps[id(one)] for one in result.hypotheses),
        )

    def _cut(self, image: Image) -> Image:
        return image[: self.camera.height * self.factor, : self.camera.width * self.factor]

    def _image(self, image: Image) -> Image:
        import cv2

        size = (self.camera.width, self.camera.height)
        return np.asarray(cv2.resize(self._cut(image), size, interpolation=cv2.INTER_AREA), np.uint8)

    def _mask(self, mask: Image) -> Image:
        """A reduced pixel is ignored if one of its original pixels is."""
        n, (height, width) = self.factor, (self.camera.height, self.camera.width)
        return np.asarray(self._cut(mask).reshape(height, n, width, n).min(axis=(1, 3)), np.uint8)

    def _map(self, map_: InitialMap) -> InitialMap:
        n, camera = self.factor, replace(self.original, source=map_.camera.source)
        if map_.camera != self.camera:  # its focal length or its distortion was estimated
            camera = replace(map_.camera.scaled(n), width=camera.width, height=camera.height)
        if map_.recipe is None:  # that of an external program: poses only
            return replace(map_, camera=camera)
        return replace(
            map_,
            observation_pixels=n * (map_.observation_pixels + 0.5) - 0.5,
            open_tracks=replace(map_.open_tracks, pixels=n * (map_.open_tracks.pixels + 0.5) - 0.5),
            recipe=map_.recipe.enlarged(n, camera, self.original),
            bundle_errors=tuple(n * error for error in map_.bundle_errors),
            reprojection_rmse_px=n * map_.reprojection_rmse_px,
            noise_px=n * map_.noise_px,
            camera=camera,
        )
