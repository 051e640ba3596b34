"""``slam-init compare``."""

from __future__ import annotations

import argparse
import sys

from slam_init.cli.parser import DONE, OUT_HELP, Commands, UsageError
from slam_init.cli.source_options import add_camera, add_mask, add_topics, view_of, with_topics
from slam_init.cli.trial_options import add_methods, add_processes, check_trials
from slam_init.system.process_io import tell
from slam_init.system.regular_file import user_path

_DEFAULT_COMPARISON = "slam-init-compare"


def add_compare(commands: Commands) -> None:
    """Add the command."""
    compare = commands.add_parser("compare", help="compare methods on the same trials", allow_abbrev=False)
    compare.description = (
        "Run methods on the same tracks from many starts; write tables, statistics and a report. The wait of a trial "
        "is the number of frames after its start until the first correct map; a trial without one counts as its limit. "
        "slam_init/compare/judging.py tells how each sequence is judged."
    )
    compare.set_defaults(command=_compare)
    compare.add_argument(
        "sources",
        metavar="SOURCE",
        nargs="*",
        help="a sequence, a folder of sequences, synth:NAME[?seed=N&...] or points:NAME[?seed=N&...]",
    )
    add_methods(compare)
    compare.add_argument("--every", type=int, default=10, metavar="K", help="start at every K-th frame (default: 10)")
    compare.add_argument("--use-every", type=int, default=1, metavar="N", help="use every N-th frame of each sequence")
    compare.add_argument("--fps", type=float, metavar="F", help="use the frames nearest to F a second, by their times")
    add_mask(compare)
    add_camera(compare, "'auto' estimates it; for all sources", "that of each source")
    compare.add_argument(
        "--min-left", type=int, default=3, metavar="N", help="start only where N frames are left (default: 3)"
    )
    compare.add_argument("--grid", type=int, default=0, metavar="N", help="add N point-level trials of each scene")
    compare.add_argument(
        "--limit-frames", type=int, default=150, metavar="N", help="a trial reads at most N frames (default: 150)"
    )
    add_processes(compare)
    compare.add_argument("--seed", type=int, default=0, metavar="N", help="of random draws (default: 0)")
    add_topics(compare)
    compare.add_argument(
        "--audit", action="store_true", help="state the risk of the map of each trial (see slam-init audit)"
    )
    compare.add_argument("--recordings", action="store_true", help="write a recording of each trial")
    compare.add_argument("--out", metavar="DIR", default=_DEFAULT_COMPARISON, help=OUT_HELP)


def _compare(arguments: argparse.Namespace) -> int:
    """``slam-init compare``."""
    check_trials(arguments, every=1, use_every=1, min_left=2, grid=0, limit_frames=2)
    if not arguments.sources and not arguments.grid:
        raise UsageError("no SOURCE: give sequences, or --grid N (see slam-init compare --help)")
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import COMPARE_FILES

    arguments.mask = view_of(arguments, arguments.use_every).mask  # absolute: workers have folders of their own
    if arguments.camera is not None and user_path(arguments.camera).exists():
        arguments.camera = str(user_path(arguments.camera).absolute())
    inputs = [*arguments.sources, *(file for file in (arguments.mask, arguments.camera) if file is not None)]
    out = chosen_folder(arguments.out, "compare", COMPARE_FILES, inputs)

    from slam_init.compare.command import run_command

    arguments.sources = [with_topics(arguments, source) for source in arguments.sources]
    tell(run_command(arguments, out, progress=sys.stderr.isatty()))
    return DONE
