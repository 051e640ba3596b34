"""Makes the recording that shows all methods side by side from the map snapshots of their trials."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from slam_init.compare.recordings import SIDE_BY_SIDE, load_snapshot, recording_folder, snapshot_name
from slam_init.compare.replay import replay
from slam_init.compare.sources import ComparedSource, open_compared
from slam_init.compare.trials import Settings
from slam_init.types.frame import Frame, Observations


def write_side_by_side(
    source: ComparedSource, start: int, settings: Settings, outcomes: Mapping[str, str]
) -> Path | None:
    """Write ``side-by-side.rrd`` of one start and remove the snapshots of its trials.

    * ``outcomes``: Method to outcome, in the order in which the methods are shown.
    * Returns: The recording. None if there are no snapshots, because all trials ended in errors or ran without
      recordings.
    """
    from slam_init.compare.methods_recorder import record_side_by_side

    folder = recording_folder(str(settings.recordings), source.label, start)
    files = {method: folder / snapshot_name(method) for method in outcomes}
    snapshots = {method: load_snapshot(path) for method, path in files.items() if path.is_file()}
    if not snapshots:
        return None
    last = max(snapshot.last_frame for snapshot in snapshots.values())
    path = folder / SIDE_BY_SIDE
    frames = _frames(source, start, last, settings)
    record_side_by_side(path, f"{source.label} {start}", snapshots, outcomes, frames)
    for file in files.values():
        file.unlink(missing_ok=True)
    return path


def _frames(source: ComparedSource, start: int, last: int, settings: Settings) -> Iterator[tuple[Frame, Observations]]:
    opened = open_compared(source.text)
    steps = replay(opened, source.text, start, Path(settings.tracks))
    for frame, step in zip(opened.frames(start, last - start + 1), steps, strict=False):
        yield frame, step.current
