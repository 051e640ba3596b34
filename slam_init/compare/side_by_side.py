"""The recording that shows the methods side by side, made from what their trials left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from slam_init.compare.map_snapshot import kept_result
from slam_init.compare.replay import replay
from slam_init.compare.sources import ComparedSource, open_compared
from slam_init.compare.trials import Settings, file_name, recording_folder
from slam_init.types.frame import Frame, Observations

__all__ = ["combine"]


def combine(source: ComparedSource, start: int, settings: Settings, outcomes: Mapping[str, str]) -> Path | None:
    """Write ``side-by-side.rrd`` of one start and take away what the trials kept for it.

    Parameters
    ----------
    source : ComparedSource
    start : int
    settings : Settings
    outcomes : mapping of str to str
        Method to outcome, in the order in which they are shown.

    Returns
    -------
    Path or None
        None where no trial left anything: all ended in errors, or were run without recordings.
    """
    from slam_init.compare.methods_recorder import record_side_by_side

    folder = recording_folder(str(settings.recordings), source.label, start)
    kept = {method: folder / f"{file_name(method)}.npz" for method in outcomes}
    results = {method: kept_result(path) for method, path in kept.items() if path.is_file()}
    if not results:
        return None
    last = max(result.last_frame for result in results.values())
    path = folder / "side-by-side.rrd"
    frames = _frames(source, start, last, settings)
    record_side_by_side(path, f"{source.label} {start}", results, outcomes, frames)
    for each in kept.values():
        each.unlink(missing_ok=True)
    return path


def _frames(source: ComparedSource, start: int, last: int, settings: Settings) -> Iterator[tuple[Frame, Observations]]:
    opened = open_compared(source.text)
    steps = replay(opened, source.text, start, Path(settings.tracks))
    for frame, step in zip(opened.frames(start, last - start + 1), steps, strict=False):
        yield frame, step.current
