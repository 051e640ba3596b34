"""``slam-init locate``."""

from __future__ import annotations

import argparse

from slam_init.cli.parser import DONE, NOT_INITIALIZED, Commands, at_least
from slam_init.cli.source_options import add_source, chosen_camera, opened_source
from slam_init.system.process_io import tell
from slam_init.system.regular_file import user_path


def add_locate(commands: Commands) -> None:
    """Add the command."""
    locate = commands.add_parser("locate", help="find the frames of another video in a saved map", allow_abbrev=False)
    locate.description = (
        "Find the frames of another video in a saved map; print each pose at once in the format of TUM RGB-D, in "
        "the frame and the unit of the map. Exit codes: 0 done, 3 no frame was found, 2 bad input."
    )
    locate.set_defaults(command=_locate)
    locate.add_argument("map", metavar="MAP", help="handover.npz, or the folder of a run or of a segment")
    add_source(locate, default=None)
    locate.add_argument("--start", type=int, default=0, metavar="K", help="skip the first K frames")
    locate.add_argument("--max-frames", type=int, metavar="N", help="read at most N frames")
    locate.add_argument("--no-grow", action="store_true", help="use the points of the saved map alone")


def _locate(arguments: argparse.Namespace) -> int:
    """``slam-init locate``."""
    at_least("--start", arguments.start, 0)
    at_least("--max-frames", arguments.max_frames, 1)
    from slam_init.datasets.place_file import load_place
    from slam_init.mapping.finding import Finder
    from slam_init.output.results import tum_line, tum_text

    place, source = load_place(user_path(arguments.map)), opened_source(arguments, 0)
    finder = Finder(place, chosen_camera(arguments, source, arguments.start), grow=not arguments.no_grow)
    read = found = 0
    reader = tell(tum_text(()))
    for frame in source.frames(arguments.start, arguments.max_frames):
        keyframe, read = finder.locate(frame).keyframe, read + 1
        if keyframe is not None:
            # At once: an interrupt, or a frame that cannot be read, leaves the poses so far.
            found, reader = found + 1, tell(tum_line(keyframe))
        if not reader:
            break
    tell(f"# {found} of {read} frames found, {len(finder.place.points)} points\n")
    return DONE if found else NOT_INITIALIZED
