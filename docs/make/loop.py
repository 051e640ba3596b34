"""Makes the loop of the front page, ``docs/images/loop.webp``: ``python docs/make/loop.py``.

A rendered camera turns and then begins to move. Left: the frames with the tracks. Right: the best map so
far in grey, from above, then the accepted map with the frames that are located in it. Below: the risk of each evaluated
window, up to the one that falls below the bound. Takes about a minute.
"""

from __future__ import annotations

import argparse
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init import Initializer, InitialMap, open_source
from slam_init.mapping.follower import follow
from slam_init.recording.recorder import Recorder

Floats = NDArray[np.float64]

SOURCE = "synth:rotate-then-move?slow_start=60&frames=130"
# The initializer sees all frames; the first ones, which only turn, are not shown.
START, FRAMES, FRAME_MS, MAP_MS, TAIL = 30, 100, 200, 2500, 7
MAX_BYTES = 3_000_000
BLUE, GREY, RED, GREEN = "#1f5fa8", "#9aa0a8", "#b3261e", "#2e8b57"


def main() -> None:
    """Run the initializer, draw each frame, and write the animation."""
    parser = argparse.ArgumentParser(description="Makes the loop of the front page.")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "images" / "loop.webp")
    out = parser.parse_args().out
    pictures = _pictures()
    # The page opens with the map, and the story follows: a reader who looks away at once has seen it.
    durations = [MAP_MS, *[FRAME_MS] * len(pictures)]
    pictures[-1].save(out, save_all=True, append_images=pictures, duration=durations, loop=0, quality=55, method=4)
    size = out.stat().st_size
    print(f"{out}: {len(durations)} frames, {sum(durations) / 1000:.0f} s, {size / 1e6:.2f} MB")
    if size > MAX_BYTES:
        raise SystemExit(f"{out} has {size} bytes: at most {MAX_BYTES} are wanted")


def _pictures() -> list[Any]:
    source = open_source(SOURCE)
    assert source.camera is not None
    initializer = Initializer(source.camera)
    canvas = _Canvas(initializer.config.acceptance.max_risk)
    pictures = []
    frames = source.frames(0, START + FRAMES)
    tails: deque[dict[int, Floats]] = deque(maxlen=TAIL)
    for frame in frames:
        status = initializer.process(frame)
        seen = initializer.tracker.history[frame.index]
        tails.append(dict(zip(seen.track_ids.tolist(), seen.pixels, strict=True)))
        canvas.show_frame(frame.image, tails)
        if status.attempt is not None and status.window is not None:
            canvas.add_risk(frame.index, status.window.risk)
            # A rotation has no map; its best translation is random.
            provisional = initializer.provisional if status.window.risk_rotation < 1 else None
            if provisional is not None and not status:
                canvas.show_map(provisional.map, f"best candidate: risk {provisional.risk:.2g}", accepted=False)
        if status and initializer.map is not None:
            canvas.show_map(initializer.map, f"map: {len(initializer.map.points)} landmarks", accepted=True)
        words = "map" if status else str(status.reason).replace("_", " ")
        canvas.say(f"frame {frame.index}: {words}", "" if status else status.advice, bool(status))
        if frame.index >= START:
            pictures.append(canvas.picture())
        if status:
            break
    result = initializer.finish()
    assert result.map is not None
    path = [keyframe.world_from_cam.t for keyframe in result.map.keyframes]
    for frame in frames:
        located = follow(result.map, initializer.tracker, iter([frame]), 1, Recorder())
        seen = initializer.tracker.history[frame.index]
        tails.append(dict(zip(seen.track_ids.tolist(), seen.pixels, strict=True)))
        canvas.show_frame(frame.image, tails, set(result.map.track_ids.tolist()))
        path += [keyframe.world_from_cam.t for keyframe in located.keyframes]
        canvas.show_path(np.array(path))
        canvas.say(f"frame {frame.index}: located in the map", "", good=True)
        pictures.append(canvas.picture())
    return pictures


class _Canvas:
    """The drawing, of which each frame changes a part.

    * ``bound``: The largest risk that is accepted.
    """

    def __init__(self, bound: float) -> None:
        import matplotlib as mpl

        mpl.use("agg")
        import matplotlib.pyplot as plt

        self._figure = plt.figure(figsize=(9.6, 5.4), dpi=100, facecolor="white")
        self._frame = self._figure.add_axes((0.01, 0.30, 0.54, 0.62))
        self._map = self._figure.add_axes((0.57, 0.30, 0.42, 0.58))
        self._risk = self._figure.add_axes((0.07, 0.09, 0.915, 0.17))
        self._risk.set(xlim=(START, START + FRAMES), ylim=(1e-4, 2), yscale="log")
        self._risk.set_ylabel("risk", fontsize=9)
        self._risk.set_xlabel("frame", fontsize=9, labelpad=1)
        self._risk.tick_params(labelsize=8)
        self._risk.axhline(bound, color=RED, ls="--", lw=1)
        self._risk.text(
            START + FRAMES - 0.5, 1.3 * bound, f"accepted below {bound:g}", color=RED, fontsize=8, ha="right"
        )
        self._risks: tuple[list[int], list[float]] = ([], [])
        (self._line,) = self._risk.plot([], [], "o-", color="black", ms=3, lw=1.2)
        self._title = self._figure.text(0.01, 0.945, "", fontsize=14, weight="bold")
        self._advice = self._figure.text(0.57, 0.945, "", fontsize=9, color="#444")
        self._blank_map("no map yet")

    def _blank_map(self, title: str) -> None:
        self._map.clear()
        self._map.set(xticks=[], yticks=[], aspect="equal", xlim=(-1.55, 1.55), ylim=(-0.35, 2.1))
        self._map.set_title(title, fontsize=10, loc="left", pad=3)
        self._map.text(0.98, 0.02, "from above", transform=self._map.transAxes, ha="right", fontsize=8, color=GREY)

    def show_frame(
        self, image: NDArray[np.uint8], tails: deque[dict[int, Floats]], mapped: set[int] | None = None
    ) -> None:
        """Show an image with the last positions of its tracks; those of the map in green."""
        from matplotlib.collections import LineCollection

        self._frame.clear()
        self._frame.set_axis_off()
        grey = image if image.ndim == 2 else image[..., ::-1]
        self._frame.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="bilinear")
        newest = tails[-1]
        lines = {track: np.array([seen[track] for seen in tails if track in seen]) for track in newest}
        colors = ["#39d98a" if mapped and track in mapped else "#ffb020" for track in lines]
        self._frame.add_collection(LineCollection(list(lines.values()), colors=colors, linewidths=0.9))
        ends = np.array(list(newest.values()))
        self._frame.scatter(ends[:, 0], ends[:, 1], s=2.5, c=colors, linewidths=0)
        self._frame.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))

    def show_map(self, map_: InitialMap, title: str, *, accepted: bool) -> None:
        """Show a map from above."""
        self._blank_map(title)
        self._map.scatter(map_.points[:, 0], map_.points[:, 2], s=4, c=BLUE if accepted else GREY, linewidths=0)
        self._cameras(np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes]))

    def show_path(self, path: Floats) -> None:
        """Add the places of the camera to the map."""
        self._cameras(path)

    def _cameras(self, path: Floats) -> None:
        for line in list(self._map.lines):
            line.remove()
        self._map.plot(path[:, 0], path[:, 2], "-", color=GREEN, lw=2)
        self._map.plot(path[-1:, 0], path[-1:, 2], "^", color=GREEN, ms=7)

    def add_risk(self, frame: int, risk: float) -> None:
        """Add an evaluated window."""
        self._risks[0].append(frame)
        self._risks[1].append(risk)
        self._line.set_data(*self._risks)

    def say(self, title: str, advice: str, good: bool) -> None:
        """Write the state above the pictures."""
        self._title.set(text=title, color=GREEN if good else RED)
        self._advice.set_text(advice)

    def picture(self) -> Any:
        """Return the drawing as an image."""
        from PIL import Image

        self._figure.canvas.draw()
        return Image.fromarray(np.asarray(self._figure.canvas.buffer_rgba())[..., :3].copy())


if __name__ == "__main__":
    main()
