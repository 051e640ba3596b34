"""The names of the files that commands write. The command line reads them, so the module imports no heavy library."""

from __future__ import annotations

#: The text model of COLMAP: cameras, images, points.
COLMAP_FILES = ("colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt")
#: The recording of a run. :mod:`slam_init.recording.rerun_recorder` writes it during the run.
RECORDING = "recording.rrd"
#: The recording of a run that was interrupted, beside the results of an earlier run.
INTERRUPTED = "interrupted.rrd"
#: The picture of a run, made at its end.
OVERVIEW = "overview.png"
#: End of the name of a recording until it is complete.
UNFINISHED = ".partial.rrd"
#: The folder of the scene that COLMAP, nerfstudio and Gaussian splatting open, and its files beside the images.
SCENE = "scene"
SCENE_FILES = (
    *(f"sparse/0/{name}.bin" for name in ("cameras", "images", "points3D")),
    # Gaussian splatting makes this file when it first opens a scene, and prefers it from then on.
    "sparse/0/points3D.ply",
    "transforms.json",
    "points.ply",
)
#: The files of a map. A run that restarts after a loss writes them to a folder for each map.
MAP_FILES = (
    "trajectory.txt",
    "map.ply",
    *COLMAP_FILES,
    "graph.txt",
    "values.txt",
    "handover.npz",
    "transforms.json",
    "continued.txt",
    *(f"{SCENE}/{name}" for name in SCENE_FILES),
)
#: All files that a run with one map can write.
RUN_FILES = (*MAP_FILES, "config.toml", OVERVIEW, RECORDING, INTERRUPTED, "summary.json")
#: The trials of a comparison, one a line, written as they finish.
TRIALS = "trials.jsonl"


def segment_folder(number: int) -> str:
    """Name the folder of a map of a run that restarts after a loss."""
    return f"segment-{number:03d}"
