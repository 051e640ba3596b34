"""Times of the frames and of the stages of sequences.

Images are given to an :class:`~slam_init.initializer.Initializer`, without reading or rendering them. All frames before
the one of the final map are *waiting* frames. The seconds to the map are those of a camera whose frames wait in
a queue while one is evaluated. The stage ``map`` is the evaluation of a window. Times are those of the processor.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam_init.initializer import Initializer
    from slam_init.types.frame import Frame, Source
    from slam_init.types.stopwatch import StageTimes

#: A camera at 30 Hz delivers a frame in this time.
_FRAME_MS = 33.3


@dataclass
class Frames:
    """Times of a sequence, in milliseconds."""

    name: str
    #: Time of each frame before the one of the final map.
    waiting_ms: list[float] = field(default_factory=list)
    #: Time of the frame of the final map; None without one.
    handover_ms: float | None = None
    #: frames, seconds: Frames and seconds until the map, for a camera whose frames wait in a queue; None without a
    #: map.
    frames: int | None = None
    seconds: float | None = None
    #: Times of each stage.
    stages_ms: dict[str, StageTimes] = field(default_factory=dict)


def measure(name: str, source: Source, max_frames: int | None = None) -> Frames:
    """Measure a sequence."""
    from slam_init.initializer import Initializer

    if source.camera is None:
        raise ValueError(f"{name}: no camera; the benchmark runs on calibrated sequences only")
    images = list(islice(source.frames(), max_frames))
    arrivals_s = [image.timestamp_s - images[0].timestamp_s for image in images]
    measured = Frames(name)
    mapped, stages_ms, times_ms = _processed(Initializer(source.camera), images)
    if mapped:
        measured.frames, measured.seconds = len(times_ms), _queued_s(arrivals_s, times_ms)
        measured.handover_ms = times_ms.pop()
    measured.waiting_ms, measured.stages_ms = times_ms, stages_ms
    return measured


def _processed(initializer: Initializer, images: Sequence[Frame]) -> tuple[bool, dict[str, StageTimes], list[float]]:
    """Whether an initializer has a map after some images, the times of its stages, and those of the frames (ms)."""
    from slam_init.types.stopwatch import Stopwatch

    times_ms: list[float] = []
    initializer.stopwatch = Stopwatch(time.process_time)
    for image in images:
        begin = time.process_time()
        mapped = bool(initializer.process(image))
        times_ms.append(1e3 * (time.process_time() - begin))
        if mapped:
            return True, initializer.stopwatch.summary(), times_ms
    return False, initializer.stopwatch.summary(), times_ms


def _queued_s(arrivals_s: Sequence[float], times_ms: Sequence[float]) -> float:
    """When the last of some frames is processed, each after the one before it and not before it arrives."""
    end_s = 0.0
    for arrival_s, time_ms in zip(arrivals_s, times_ms, strict=False):
        end_s = max(end_s, arrival_s) + 1e-3 * time_ms
    return end_s


def frames_table(measured: Sequence[Frames], flow_ms: float) -> str:
    """The table of the frames."""
    import numpy as np

    from tests.benchmarks.tables import markdown_table, number

    header = [
        "ms (ratio to the flow)", "waiting frames", "median", "99th percentile", "largest", "above 33 ms",
        "hand-over", "to the map",
    ]  # fmt: skip
    rows = []
    for one in measured:
        waiting = np.array(one.waiting_ms or [np.nan])
        times = [float(np.median(waiting)), float(np.percentile(waiting, 99)), float(waiting.max())]
        shown = [f"{number(ms, 1)} ({ms / flow_ms:.1f})" for ms in times]
        handover = "-" if one.handover_ms is None else f"{one.handover_ms:.1f} ({one.handover_ms / flow_ms:.1f})"
        end = "-" if one.frames is None else f"{one.frames} frames, {one.seconds:.2f} s"
        late = f"{float((waiting > _FRAME_MS).mean()):.1%}"
        rows.append([one.name, str(len(one.waiting_ms)), *shown, late, handover, end])
    return markdown_table(header, rows)


def stages_table(measured: Sequence[Frames]) -> str:
    """The table of the stages."""
    from tests.benchmarks.tables import markdown_table

    stages = list(dict.fromkeys(stage for one in measured for stage in one.stages_ms))
    rows = []
    for one in measured:
        cells = [one.stages_ms.get(stage) for stage in stages]
        shown = [f"{cell['median']:.1f} / {cell['p95']:.1f} ({cell['calls']:.0f})" if cell else "-" for cell in cells]
        rows.append([one.name, *shown])
    return markdown_table(["ms a call: median / 95th percentile (calls)", *stages], rows)
