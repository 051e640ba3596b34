"""``slam-init audit``."""

from __future__ import annotations

import argparse
from dataclasses import replace

from slam_init.cli.parser import DONE, DOUBTFUL, WRONG, Commands, add_command, add_options
from slam_init.errors import CalibrationError, SlamInitError, SourceError
from slam_init.system.process_io import emit
from slam_init.system.regular_file import user_path

_OTHER_IMAGES = (
    "the points of the map move otherwise in these images: they do not belong together: give the images of the map"
)


def add_audit(commands: Commands) -> None:
    """Add the command."""
    description = (
        "State the risk that a map from anywhere is wrong, term by term, and what would decide. Exit codes: 0 sound, 3 "
        "doubtful, 4 wrong, 2 bad input."
    )
    audit = add_command(commands, "audit", _audit, "state the risk that a map from anywhere is wrong", description)
    audit.add_argument(
        "map",
        metavar="MAP",
        help="handover.npz, the folder of a run, the folder of a COLMAP model, gtsam's graph.txt, nerfstudio's "
        "transforms.json, or a trajectory: columns with a header, TUM's format (ORB-SLAM's keyframes), or KITTI's",
    )
    helps = {
        "--images SOURCE": "the images of the map, or its matches (COLMAP's database, .h5, .npz): their tracks are "
        "used in place of those that the map has kept. A trajectory needs them",
        "--camera FILE": "calibration, or f=1250 or fov=72 (default: that of the map, else of --images)",
        "--json": "print it as JSON",
    }
    add_options(audit, helps)


def _audit(arguments: argparse.Namespace) -> int:
    """``slam-init audit``."""
    from slam_init.auditing.audit import audit
    from slam_init.auditing.readings import fitting_reading
    from slam_init.calibration.files import load_camera
    from slam_init.config import Config
    from slam_init.datasets import open_source
    from slam_init.datasets.map_files import moves_otherwise, open_map, tracked_by
    from slam_init.output.plain_json import json_text
    from slam_init.types.audit import AuditVerdict

    map_, config = open_map(user_path(arguments.map)), Config()
    source = None if arguments.images is None else open_source(arguments.images)
    if source is None and map_.images is not None:
        try:
            source = open_source(map_.images)
        except SourceError as error:
            raise SourceError(f"{error}: give them by --images") from None
    camera = map_.camera or (None if source is None else source.camera)
    if arguments.camera is not None:
        size = None if camera is None else (camera.width, camera.height)
        if source is not None:
            height, width = next(source.frames(0, 1)).image.shape[:2]
            size = width, height
        camera = load_camera(arguments.camera, size)
    if source is None and map_.table is None:
        raise SourceError(f"{arguments.map}: a trajectory has no tracks: give the images by --images")
    if camera is None:
        raise CalibrationError(f"{arguments.map}: has no calibration: give --camera FILE")
    if source is None:
        poses, views, notes = map_.poses, map_.tracks(camera), tuple[str, ...]()
    else:
        poses, views, notes = tracked_by(map_, source, camera, config)
    try:
        fitting = fitting_reading(poses, views, camera, config)
        taken = fitting if map_.is_trajectory else None
        found = audit(poses, views, camera, config) if taken is None else taken.audit
    except SlamInitError as error:
        raise SourceError(f"{arguments.map}: {error}") from None
    if taken is not None:
        notes = (*notes, f"the poses were read as {taken.reading}, since the tracks contradict world_from_cam")
    elif not found and fitting is not None:
        found = replace(found, reason=None, advice=f"the poses fit as {fitting.reading}: convert them")
    elif not found and source is not None and moves_otherwise(map_, poses, views, found.pair):
        found = replace(found, reason=None, advice=_OTHER_IMAGES)
    found = replace(found, notes=notes)
    emit(json_text(found) if arguments.json else f"{found}\n")
    if found:
        return DONE
    return WRONG if found.verdict is AuditVerdict.WRONG else DOUBTFUL
