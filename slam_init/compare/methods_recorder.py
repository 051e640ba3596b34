"""Several methods on the same start, side by side in one recording.

==============================  ===================================================================
entity                          content
==============================  ===================================================================
``frame/image``                 the image now, with the tracks that all methods are fed with
``NAME/map``                    a method's map once it has one: ``points``, ``keyframes``, ``est``, ``gt``
``NAME/verdict``                what its last attempt said
==============================  ===================================================================

The timeline is ``frame`` (absolute index). Each map has its own first keyframe as frame and its own median depth as
unit, so that equal maps look equal.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.compare.map_snapshot import KeptResult
from slam_init.recording.images import jpeg, reduced
from slam_init.recording.layout import ESTIMATE_COLOR, TRUTH_COLOR, name_parts
from slam_init.types.frame import Frame, Observations

__all__ = ["record_side_by_side"]

_LONG_SIDE_PX = 640
_GREEN, _RED, _YELLOW = (60, 200, 90), (230, 70, 70), (255, 200, 40)
#: Half the length of a keyframe's axes in units of the map.
_AXIS = 0.05
#: Chunks end after this many bytes and never by the clock, so that two runs write the same ones.
_CHUNK_BYTES = 1 << 19


def record_side_by_side(
    path: Path,
    name: str,
    results: Mapping[str, KeptResult],
    outcomes: Mapping[str, str],
    frames: Iterable[tuple[Frame, Observations]],
) -> None:
    """Write the recording.

    Parameters
    ----------
    path : Path
    name : str
        Of the source and start.
    results : mapping of str to KeptResult
        By method, in the order in which they are shown.
    outcomes : mapping of str to str
        By method, e.g. ``correct``; shown beside its map.
    frames : iterable of (Frame, Observations)
        In time order.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "false")
    import rerun as rr

    entities = {method: f"method-{i:02d}" for i, method in enumerate(results)}
    batching = rr.ChunkBatcherConfig.NEVER()
    batching.flush_num_bytes = _CHUNK_BYTES
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"slam-init/{name}/{'/'.join(results)}")
    rec = rr.RecordingStream("slam_init_compare", recording_id=identity, send_properties=False, batcher_config=batching)
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    partial = path.with_suffix(".partial.rrd")
    rec.save(partial, default_blueprint=_blueprint(entities))
    rec.send_recording_name(f"slam-init compare {name}")
    for entity in entities.values():
        rec.log(f"{entity}/map", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
    for frame, observations in frames:
        rec.set_time("frame", sequence=frame.index)
        scale = min(1.0, _LONG_SIDE_PX / max(frame.image.shape[:2]))
        rec.log("frame/image", jpeg(reduced(frame.image, _LONG_SIDE_PX)))
        pixels = (observations.pixels + 0.5) * scale
        rec.log("frame/image/tracks", rr.Points2D(pixels, colors=[_GREEN], radii=rr.Radius.ui_points(2)))
        for method, result in results.items():
            _log_frame(rec, entities[method], result, outcomes.get(method, ""), frame.index)
    rec.disconnect()
    partial.replace(path)


def _log_frame(rec: Any, entity: str, result: KeptResult, outcome: str, frame: int) -> None:
    """What a method has to say at a frame."""
    import rerun as rr

    if frame == result.last_frame:
        if len(result.poses):
            _log_map(rec, f"{entity}/map", result)
            keyframes = f"{len(result.poses)} keyframes, {len(result.points)} landmarks"
            text = f"**{outcome}** at frame {frame}: {keyframes}"
        else:
            text = f"**no map**: {result.reason}"
    else:
        said = [verdict for at, verdict, _ in result.verdicts.tolist() if int(at) == frame]
        if not said:
            return
        text = f"frame {frame}: {said[-1]}"
    rec.log(f"{entity}/verdict", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def _log_map(rec: Any, entity: str, result: KeptResult) -> None:
    import rerun as rr

    rec.log(f"{entity}/points", rr.Points3D(result.points, colors=result.colors, radii=rr.Radius.ui_points(2)))
    centres = result.poses[:, :3, 3]
    axes = _AXIS * result.poses[:, :3, :3].transpose(0, 2, 1).reshape(-1, 3)
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
    if len(result.truth):
        rec.log(f"{entity}/gt", rr.LineStrips3D([result.truth], colors=[TRUTH_COLOR], radii=rr.Radius.ui_points(2)))


def _blueprint(entities: Mapping[str, str]) -> Any:
    """The frame at the left, a map with its verdict for each method at the right."""
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
