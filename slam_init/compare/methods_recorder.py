"""Records several methods from the same start side by side in one rerun recording.

==============================  ===================================================================
entity                          content
==============================  ===================================================================
``frame/image``                 the current image, with the tracks that all methods get
``NAME/map``                    the map of a method: ``points``, ``keyframes``, ``est``, ``gt``
``NAME/verdict``                the verdict of its last attempt
==============================  ===================================================================

The timeline is ``frame`` (absolute index). Each map is drawn in the coordinates of its own first keyframe, with its own
median depth as unit, so that equal maps look equal.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.map_snapshot import MapSnapshot
from slam_init.recording.images import jpeg, reduced
from slam_init.recording.layout import ESTIMATE_COLOR, TRUTH_COLOR, name_parts
from slam_init.recording.recording_file import RecordingFile
from slam_init.types.frame import Frame, Observations

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

__all__ = ["record_side_by_side"]

_LONG_SIDE_PX = 640
_GREEN, _RED, _YELLOW = (60, 200, 90), (230, 70, 70), (255, 200, 40)
#: Half the length of a keyframe's axes in units of the map.
_AXIS = 0.05
#: A chunk ends after this number of bytes and never after a time, so that two runs write the same chunks.
_CHUNK_BYTES = 1 << 19


def record_side_by_side(
    path: str | os.PathLike[str],
    name: str,
    snapshots: Mapping[str, MapSnapshot],
    outcomes: Mapping[str, str],
    frames: Iterable[tuple[Frame, Observations]],
) -> None:
    """Write the recording.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    name : str
        Name of the recording: source and start.
    snapshots : mapping of str to MapSnapshot
        By method, in the order in which they are shown.
    outcomes : mapping of str to str
        By method, for example ``correct``; shown beside the map.
    frames : iterable of (Frame, Observations)
        In time order.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "false")
    import rerun as rr

    entities = {method: f"method-{i:02d}" for i, method in enumerate(snapshots)}
    batching = rr.ChunkBatcherConfig.NEVER()
    batching.flush_num_bytes = _CHUNK_BYTES
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"slam-init/{name}/{'/'.join(snapshots)}")
    rec = rr.RecordingStream("slam_init_compare", recording_id=identity, send_properties=False, batcher_config=batching)
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    file = RecordingFile(Path(path), rec, _blueprint(entities))
    rec.send_recording_name(f"slam-init compare {name}")
    for entity in entities.values():
        rec.log(f"{entity}/map", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
    for frame, observations in frames:
        file.check()
        rec.set_time("frame", sequence=frame.index)
        scale = min(1.0, _LONG_SIDE_PX / max(frame.image.shape[:2]))
        rec.log("frame/image", jpeg(reduced(frame.image, _LONG_SIDE_PX)))
        pixels = (observations.pixels + 0.5) * scale
        rec.log("frame/image/tracks", rr.Points2D(pixels, colors=[_GREEN], radii=rr.Radius.ui_points(2)))
        for method, snapshot in snapshots.items():
            _log_frame(rec, entities[method], snapshot, outcomes.get(method, ""), frame.index)
    file.complete()


def _log_frame(rec: rr.RecordingStream, entity: str, snapshot: MapSnapshot, outcome: str, frame: int) -> None:
    """Log the verdict of a method at a frame, and its map at the frame at which it was accepted."""
    import rerun as rr

    if frame == snapshot.last_frame:
        if len(snapshot.poses):
            _log_map(rec, f"{entity}/map", snapshot)
            keyframes = f"{len(snapshot.poses)} keyframes, {len(snapshot.points)} landmarks"
            text = f"**{outcome}** at frame {frame}: {keyframes}"
        else:
            text = f"**no map**: {snapshot.reason}"
    else:
        verdicts = [verdict for at, verdict, _ in snapshot.verdicts.tolist() if int(at) == frame]
        if not verdicts:
            return
        text = f"frame {frame}: {verdicts[-1]}"
    rec.log(f"{entity}/verdict", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


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
            colors=[_RED, _GREEN, ESTIMATE_COLOR] * len(centres),
            radii=rr.Radius.ui_points(1),
        ),
    )
    rec.log(f"{entity}/est", rr.LineStrips3D([centres], colors=[ESTIMATE_COLOR], radii=rr.Radius.ui_points(1.5)))
    if len(snapshot.truth):
        rec.log(f"{entity}/gt", rr.LineStrips3D([snapshot.truth], colors=[TRUTH_COLOR], radii=rr.Radius.ui_points(2)))


def _blueprint(entities: Mapping[str, str]) -> rrb.Blueprint:
    """Return the layout: the frame at the left, and the map and the verdict of each method at the right."""
    import rerun.blueprint as rrb

    eye = rrb.EyeControls3D(position=(-0.4, -0.45, -0.65), look_target=(0.0, 0.0, 0.8), eye_up=(0, -1, 0))
    cells = [
        rrb.Vertical(
            rrb.Spatial3DView(origin=f"{entity}/map", name=method, line_grid=False, eye_controls=eye),
            rrb.TextDocumentView(origin=f"{entity}/verdict", name="verdict"),
            row_shares=[4, 1],
        )
        for method, entity in entities.items()
    ]
    root = rrb.Horizontal(
        rrb.Spatial2DView(origin="frame/image", name="frame and tracks"),
        rrb.Grid(*cells, grid_columns=2 if len(cells) <= 4 else 3 if len(cells) <= 9 else 4),
        column_shares=[2, 3],
    )
    name_parts(root, "slam-init-compare")
    return rrb.Blueprint(root, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)
