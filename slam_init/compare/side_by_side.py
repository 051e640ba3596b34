"""Makes the recording that shows all methods side by side from the map snapshots of their trials."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.recordings import SIDE_BY_SIDE, MapSnapshot, load_snapshot, recording_folder, snapshot_name
from slam_init.compare.replay import replay
from slam_init.compare.sources import ComparedSource, open_compared
from slam_init.compare.trials import Settings
from slam_init.errors import plain_line
from slam_init.recording.images import jpeg, reduced
from slam_init.recording.layout import ESTIMATE_COLOR, GREEN, RED, TRUTH_COLOR, YELLOW, behind_first_camera, name_parts
from slam_init.recording.recording_file import RecordingFile, open_stream
from slam_init.types.frame import Frame, Observations
from slam_init.types.reasons import in_words

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_LONG_SIDE_PX = 640
_LEGEND = """
| colour | |
|---|---|
| green points | the tracks that all methods get |
| blue line | estimated path; the axes at its points are the keyframes |
| orange line | true path, aligned to the estimate |
| log, green | a correct map |
| log, red | a wrong map |
| log, yellow | no map yet, or none at all |

Each map has its own median depth as unit.
"""
#: Half the length of a keyframe's axes in units of the map.
_AXIS = 0.05


def record_side_by_side(
    path: str | os.PathLike[str],
    name: str,
    snapshots: Mapping[str, MapSnapshot],
    outcomes: Mapping[str, str],
    frames: Iterable[tuple[Frame, Observations]],
) -> None:
    """Write the recording."""
    os.environ.setdefault("RERUN_ANALYTICS", "false")
    import rerun as rr

    entities = {method: f"method-{i:02d}" for i, method in enumerate(snapshots)}
    rec = open_stream("slam_init_compare", f"slam-init/{name}/{'/'.join(snapshots)}")
    with_map = {method for method, snapshot in snapshots.items() if len(snapshot.poses)}
    file = RecordingFile(Path(path), rec, _blueprint(entities, with_map))
    rec.send_recording_name(f"slam-init compare {name}")
    rec.log("legend", rr.TextDocument(_LEGEND, media_type=rr.MediaType.MARKDOWN), static=True)
    for entity in entities.values():
        rec.log(f"{entity}/map", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
    for frame, observations in frames:
        file.check()
        rec.set_time("frame", sequence=frame.index)
        scale = min(1.0, _LONG_SIDE_PX / max(frame.image.shape[:2]))
        rec.log("frame/image", jpeg(reduced(frame.image, _LONG_SIDE_PX)))
        pixels = (observations.pixels + 0.5) * scale
        rec.log("frame/image/tracks", rr.Points2D(pixels, colors=[GREEN], radii=rr.Radius.ui_points(2)))
        for method, snapshot in snapshots.items():
            _log_frame(rec, method, entities[method], snapshot, outcomes.get(method, ""), frame.index)
    file.complete()


def _log_frame(
    rec: rr.RecordingStream, method: str, entity: str, snapshot: MapSnapshot, outcome: str, frame: int
) -> None:
    """Log the verdict of a method at a frame, and its map at the frame at which it was accepted."""
    import rerun as rr

    color = YELLOW
    if frame == snapshot.last_frame:
        if len(snapshot.poses):
            _log_map(rec, f"{entity}/map", snapshot)
            said = f"{outcome} at frame {frame}: {len(snapshot.poses)} keyframes, {len(snapshot.points)} landmarks"
            color, advice = GREEN if outcome == "correct" else RED, ""
        else:
            said, advice = f"no map: {in_words(plain_line(snapshot.reason))}", _advice(snapshot, snapshot.reason)
    else:
        attempts = [(verdict, advice) for at, verdict, advice in snapshot.verdicts.tolist() if int(at) == frame]
        if not attempts:
            return
        said, advice = in_words(plain_line(attempts[-1][0])), attempts[-1][1]
    text = f"**{said}**\n\n{plain_line(advice)}" if advice else f"**{said}**"
    rec.log(f"{entity}/verdict", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
    rec.log("log", rr.TextLog(f"{method}: {said}", color=color))


def _advice(snapshot: MapSnapshot, reason: str) -> str:
    """The advice of the last attempt that was refused for a reason."""
    return next((advice for _, verdict, advice in reversed(snapshot.verdicts.tolist()) if verdict == reason), "")


def _log_map(rec: rr.RecordingStream, entity: str, snapshot: MapSnapshot) -> None:
    import rerun as rr

    rec.log(f"{entity}/points", rr.Points3D(snapshot.points, colors=snapshot.colors, radii=rr.Radius.ui_points(2)))
    centres = snapshot.poses[:, :3, 3]
    axes = _AXIS * snapshot.poses[:, :3, :3].transpose(0, 2, 1).reshape(-1, 3)
    rec.log(
        f"{entity}/keyframes",
        rr.Arrows3D(
            origins=np.repeat(centres, 3, axis=0),
            vectors=axes,
            colors=[RED, GREEN, ESTIMATE_COLOR] * len(centres),
            radii=rr.Radius.ui_points(1),
        ),
    )
    rec.log(f"{entity}/est", rr.LineStrips3D([centres], colors=[ESTIMATE_COLOR], radii=rr.Radius.ui_points(1.5)))
    if len(snapshot.truth):
        rec.log(f"{entity}/gt", rr.LineStrips3D([snapshot.truth], colors=[TRUTH_COLOR], radii=rr.Radius.ui_points(2)))


def _blueprint(entities: Mapping[str, str], with_map: Set[str]) -> rrb.Blueprint:
    """Return the layout: frame and log at the left, and the map and the verdict of each method at the right.

    A method without a map has no view of one: its verdict fills the place.
    """
    import rerun.blueprint as rrb

    cells = [
        rrb.Vertical(
            rrb.Spatial3DView(origin=f"{entity}/map", name=method, line_grid=False, eye_controls=behind_first_camera()),
            rrb.TextDocumentView(origin=f"{entity}/verdict", name=f"verdict of {method}"),
            row_shares=[3, 1],
        )
        if method in with_map
        else rrb.TextDocumentView(origin=f"{entity}/verdict", name=f"{method}: no map")
        for method, entity in entities.items()
    ]
    columns = rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"])
    root = rrb.Horizontal(
        rrb.Vertical(
            rrb.Spatial2DView(origin="frame/image", name="frame and tracks"),
            rrb.Tabs(
                rrb.TextLogView(origin="log", name="verdicts", columns=columns),
                rrb.TextDocumentView(origin="legend", name="legend"),
            ),
            row_shares=[1, 1],
        ),
        rrb.Grid(*cells, grid_columns=2 if len(cells) <= 4 else 3 if len(cells) <= 9 else 4),
        column_shares=[2, 3],
    )
    name_parts(root, "slam-init-compare")
    return rrb.Blueprint(root, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)


def write_side_by_side(
    source: ComparedSource, start: int, settings: Settings, outcomes: Mapping[str, str]
) -> Path | None:
    """Write ``side-by-side.rrd`` of one start and remove the snapshots of its trials.

    * ``outcomes``: Method to outcome, in the order in which the methods are shown.
    * Returns: The recording. None if there are no snapshots, because all trials ended in errors or ran without
      recordings.
    """
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
