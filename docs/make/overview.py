"""Draws ``docs/images/overview.png``: a run on a rendered room, and the two maps of a rendered wall.

    python docs/make/overview.py

The camera approaches the wall in a straight line. Two motions explain its first views, and both maps are kept.
Further views decide. The picture has 256 colours, so that it is below 300 kB.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sequences_synth import make_sequence
from sequences_synth.render import render
from slam_init.datasets import open_source
from slam_init.initializer import Initializer
from slam_init.pictures.drawing import (
    ABOVE,
    ESTIMATE,
    FAINT,
    INK,
    INLIER,
    OUTLIER,
    SIDE,
    TRACK,
    VERDICT_COLORS,
    canvas,
    draw_frame,
    draw_map,
    draw_pair,
    pixels_of,
    write,
)  # fmt: skip
from slam_init.recording.recorder import StoryRecorder
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap
from slam_init.types.refusal import Verdict
from slam_init.types.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH_PX, _HEIGHT_PX = 1320, 640
_ROOM = "synth:room"
_WALL_SEED = 0
#: Step of the camera towards the wall, in median depths: right and forward. The direction lies near the normal of the
#: wall, so that the second motion of the plane keeps all points in front of the cameras.
_STEP = (0.02, 0.0, 0.06)
#: Colours that the palette of the file must have.
_LINES = (ESTIMATE, INLIER, OUTLIER, TRACK, VERDICT_COLORS[Verdict.AMBIGUOUS_PLANE])
_NEARLY_WHITE = 248
#: Standard deviation of the luminance, in grey levels.
_NOISE = 3.0
#: Frames of the wall until one of the maps is accepted, at the most.
_WALL_FRAMES = 8


def main() -> None:
    """Run both scenes, and write the picture."""
    parser = argparse.ArgumentParser(description="Draw the picture of the README.")
    parser.add_argument("--out", type=Path, default=Path("docs/images/overview.png"))
    out = parser.parse_args().out
    room = open_source(_ROOM)
    assert room.camera is not None
    found, story, _ = _run(room.camera, room.frames())
    camera, frames = _wall()
    decided, wall_story, both = _run(camera, frames)
    assert found and decided and both is not None, "the scenes are chosen so that they initialize"
    with canvas(_WIDTH_PX, _HEIGHT_PX) as figure:
        _draw_room(figure, found, story, room.camera)
        _draw_wall(figure, both, decided, wall_story, camera)
        rgb = pixels_of(figure)
    out.parent.mkdir(parents=True, exist_ok=True)
    _write(out, rgb)
    print(f"{out}: {out.stat().st_size / 1000:.0f} kB")


def _run(camera: Camera, frames: Iterable[Frame]) -> tuple[Result, StoryRecorder, Result | None]:
    """Process frames until there is a map; return the last result with two undecided maps besides."""
    recorder, both = StoryRecorder(), None
    initializer = Initializer(camera, recorder=recorder)
    for frame in frames:
        if initializer.process(frame):
            break
        if len(initializer.result.hypotheses) == 2:
            both = initializer.result
    return initializer.finish(), recorder, both


def _wall() -> tuple[Camera, Iterator[Frame]]:
    """A camera that approaches one rendered wall in a straight line, without a rotation."""
    sequence = make_sequence("wall", _WALL_SEED)
    seen = sequence.camera
    camera = Camera("pinhole", seen.width, seen.height, seen.fx, seen.fy, seen.cx, seen.cy)
    start = sequence.poses[0]
    depth = float(np.median(sequence.render(0)[1]))

    def frames() -> Iterator[Frame]:
        rng = np.random.default_rng(_WALL_SEED)
        for k in range(_WALL_FRAMES):
            pose = start.copy()
            pose[:3, 3] += k * depth * start[:3, :3] @ _STEP
            view = render(sequence.sensors[0].quads, camera.K, np.linalg.inv(pose), seen.width, seen.height)
            noisy = view.image + rng.normal(0, _NOISE, view.image.shape)
            yield Frame(k, k / 30, f"{k:04d}.png", np.clip(noisy, 0, 255).astype(np.uint8))

    return camera, frames()


def _draw_room(figure: Figure, result: Result, story: StoryRecorder, camera: Camera) -> None:
    """Above: a frame with its tracks, the pair and the map."""
    assert result.map is not None and story.pair is not None
    title = figure.add_axes((0.015, 0.93, 0.97, 0.06))
    title.axis("off")
    write(
        title,
        0.0,
        0.95,
        f"Frames in, map out: a room, initialized after {result.frames_to_init} frames",
        17,
        INK,
        "bold",
    )
    title.plot([-0.008, -0.008], [0.0, 0.95], color=INLIER, linewidth=6, transform=title.transAxes, clip_on=False)
    last = story.frames[-1]
    known = np.isin(last.track_ids, result.map.track_ids)
    draw_frame(figure.add_axes((0.015, 0.56, 0.2, 0.31)), last, story.frames[0], camera.width, known)
    draw_pair(figure.add_axes((0.23, 0.56, 0.40, 0.31)), story.pair, camera.width)
    _draw_map(figure, (0.645, 0.545, 0.165, 0.325), result.map, ABOVE, "the map from above")
    _draw_map(figure, (0.82, 0.545, 0.165, 0.325), result.map, SIDE, "from the side")


def _draw_map(figure: Figure, box: tuple[float, float, float, float], map_: InitialMap, view: str, title: str) -> None:
    """A small view of a map, without room for the numbers of its axes."""
    axes = figure.add_axes(box)
    draw_map(axes, map_, view, title)
    axes.set(xticks=[], yticks=[], xlabel="")


def _draw_wall(figure: Figure, both: Result, decided: Result, story: StoryRecorder, camera: Camera) -> None:
    """Below: the pair on a wall, and the maps of both motions."""
    assert story.pair is not None
    title = figure.add_axes((0.015, 0.43, 0.97, 0.06))
    title.axis("off")
    color = VERDICT_COLORS[Verdict.AMBIGUOUS_PLANE]
    title.plot([-0.008, -0.008], [0.0, 0.95], color=color, linewidth=6, transform=title.transAxes, clip_on=False)
    kept, accepted = both.frames_read, decided.frames_to_init
    words = f"A wall allows two maps: both are kept after {kept} frames, and after {accepted} one is accepted"
    write(title, 0.0, 0.95, words, 17, INK, "bold")
    draw_pair(figure.add_axes((0.015, 0.055, 0.40, 0.31)), story.pair, camera.width)
    for k, (map_, name) in enumerate(zip(both.hypotheses, "AB", strict=True)):
        left = 0.43 + 0.285 * k
        _draw_map(figure, (left, 0.055, 0.135, 0.31), map_, ABOVE, f"map {name} from above")
        _draw_map(figure, (left + 0.138, 0.055, 0.135, 0.31), map_, SIDE, "from the side")
    note = figure.add_axes((0.43, 0.0, 0.555, 0.05))
    note.axis("off")
    write(note, 0.0, 0.85, "points: landmarks   |   blue: cameras", 9.5, FAINT)


def _write(out: Path, rgb: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(rgb))
    # Thin lines have few pixels, and a palette of the frequent colours would lack theirs.
    room = 256 - len(_LINES)
    common = picture.quantize(room, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*common[: 3 * room], *(value for line in _LINES for value in bytes.fromhex(line[1:]))])
    small = picture.quantize(palette=palette, dither=Image.Dither.NONE)
    # The search for the nearest colour is not exact, so that white paper would be light grey.
    small.putpalette([255 if value >= _NEARLY_WHITE else value for value in small.getpalette() or []])
    small.save(out, optimize=True)


if __name__ == "__main__":
    main()
