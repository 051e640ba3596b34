"""A map with its images as a scene that COLMAP, nerfstudio and Gaussian splatting open."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence

from slam_init.datasets.track_source import TrackSource
from slam_init.errors import SlamInitError, SourceError, check_type
from slam_init.output.folder import OutputFolder
from slam_init.output.names import SCENE
from slam_init.output.scene import Undistortion, image_name, png, scene_files
from slam_init.types.arrays import Image
from slam_init.types.frame import Frame, Source, as_image
from slam_init.types.initial_map import InitialMap, Keyframe


def export(
    map_: InitialMap,
    folder: str | os.PathLike[str],
    formats: Collection[str] = ("scene",),
    images: Source | Mapping[int, Image] | None = None,
    located: Sequence[Keyframe] = (),
) -> None:
    """Write a map in the formats of other tools: either all files are replaced, or none.

    Parameters
    ----------
    map_ : InitialMap
    folder : str or path
        A folder that is new, empty, or was written by an earlier call.
    formats : collection of str
        ``scene`` (COLMAP, nerfstudio, Gaussian splatting): see ``docs/how-to/continue.md``.
    images : Source or mapping of int to (H, W) or (H, W, 3) array_like, optional
        The images of the keyframes and of the located frames, by absolute index: grey or BGR, as the initializer got
        them. A source is read again.
    located : sequence of Keyframe
        Further frames with known poses.

    Raises
    ------
    SlamInitError
        If a format is unknown, an image is missing, or a file cannot be written.
    """
    InitialMap.check(map_)
    check_type(located, (tuple, list), "located", "a list of the Keyframes of frames with known poses")
    for one in located:
        check_type(one, Keyframe, "a located frame", "the Keyframes of frames with known poses")
    check_formats(formats)
    with OutputFolder(folder, "export") as out:
        stage(out, "", map_, formats, images, located)
        out.publish()


def check_formats(formats: Collection[str], source: Source | None = None) -> None:
    """Refuse, before any work, formats that are unknown, or that need images which a source does not give again."""
    if isinstance(formats, str) or not isinstance(formats, Collection):
        raise SlamInitError(f"the formats of an export are {formats!r:.40}: give a list, as in ['scene']")
    for one in formats:
        if one != SCENE:
            raise SlamInitError(f"unknown format {one!r:.40} of an export: use {SCENE}")
    if formats and source is not None and source.kind == "live":
        raise SlamInitError("the export scene reads the images again, and a live source is gone: record it first")
    if formats and isinstance(source, TrackSource) and source.pictures is None:
        raise SlamInitError("the export scene needs images: name them by --images")


def stage(
    out: OutputFolder,
    prefix: str,
    map_: InitialMap,
    formats: Collection[str],
    images: Source | Mapping[int, Image] | None,
    located: Sequence[Keyframe] = (),
) -> None:
    """Write the scene of a map to the staging folder, if it is one of the formats.

    * ``prefix``: Of the names of all files.
    """
    if not formats:
        return
    views = {one.frame: one for one in (*located, *map_.keyframes)}
    keyframes = [one.frame for one in map_.keyframes]
    undistortion = Undistortion.of(map_.camera)
    for frame in _frames(images, views):
        as_image(frame.image, f"the image of frame {frame.index}", (map_.camera.width, map_.camera.height))
        image = png(undistortion.image(frame.image))
        out.write({f"{prefix}{SCENE}/images/{image_name(frame.index)}": image})
    files = scene_files(map_, [one for one in views.values() if one.frame not in keyframes], undistortion)
    out.write({f"{prefix}{name}": content for name, content in files.items()})


def _frames(images: Source | Mapping[int, Image] | None, wanted: Collection[int]) -> Iterator[Frame]:
    """The frames of some indices, in order."""
    missing = set(wanted)
    found: Iterator[Frame] = iter(())
    if isinstance(images, Mapping):
        found = (Frame(i, 0.0, image_name(i), images[i]) for i in sorted(missing) if i in images)
    elif images is not None:
        if not callable(getattr(images, "frames", None)):
            kind = type(images).__name__
            raise SourceError(f"the images are of the type {kind}: give open_source(PATH), or a dict by frame")
        found = (frame for frame in images.frames(start=min(missing)))
    for frame in found:
        if frame.index in missing:
            missing.remove(frame.index)
            yield frame
        if not missing:
            return
    raise SourceError(f"the export needs the image of frame {min(missing)}: give the images of all frames of the map")
