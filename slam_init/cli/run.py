"""``slam-init run``."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from slam_init.cli.exit_codes import DONE, NOT_INITIALIZED
from slam_init.cli.parser import at_least
from slam_init.cli.source_options import add_source, chosen_camera, opened_source
from slam_init.process_io import tell
from slam_init.regular_file import user_path

if TYPE_CHECKING:
    from slam_init.cli.parser import Commands

__all__ = ["add_run"]

_DEFAULT_SOURCE = "synth:room"
_DEFAULT_OUT = "slam-init-out"


def add_run(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse subparsers
    """
    run = commands.add_parser("run", help="initialize from a sequence", allow_abbrev=False)
    run.description = "Read frames until a map is found; write it, and a recording of how, to a folder."
    run.set_defaults(command=_run)
    add_source(run, default=_DEFAULT_SOURCE)
    run.add_argument(
        "--out",
        metavar="DIR",
        default=_DEFAULT_OUT,
        help="results: a new or empty folder, or one of an earlier run (default: %(default)s)",
    )
    run.add_argument(
        "--method", metavar="NAME", help="way to initialize: quest (default), orb-slam3, ...; a wrong name lists all"
    )
    run.add_argument("--seed", type=int, metavar="N", help="of random draws and synthetic worlds (default: 0)")
    run.add_argument("--start", type=int, default=0, metavar="K", help="skip the first K frames")
    run.add_argument("--max-frames", type=int, metavar="N", help="give up after N frames")
    run.add_argument(
        "--continue",
        type=int,
        default=0,
        metavar="N",
        dest="continue_frames",
        help="then resect the next N frames with the map",
    )
    run.add_argument(
        "--realtime", action="store_true", help="judge in slices, as for a camera that does not wait for the result"
    )
    run.add_argument("--refine-focal", action="store_true", help="adjust the focal length with the map")
    run.add_argument("--config", metavar="FILE", help="options in TOML, as in DIR/config.toml")
    run.add_argument("--no-overview", action="store_true", help="do not draw DIR/overview.png")
    run.add_argument("--json", action="store_true", help="print the summary as JSON and nothing else")
    run.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")


def _run(arguments: argparse.Namespace) -> int:
    """``slam-init run``."""
    at_least("--start", arguments.start, 0)
    at_least("--max-frames", arguments.max_frames, 1)
    at_least("--continue", arguments.continue_frames, 0)
    at_least("--seed", arguments.seed, 0)
    config_path = user_path(arguments.config) if arguments.config is not None else None
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import RUN_FILES

    named = (arguments.images, arguments.camera, config_path)
    inputs = [arguments.source, *(file for file in named if file is not None)]
    out = chosen_folder(arguments.out, "run", RUN_FILES, inputs)

    from slam_init.config import REALTIME_WORK, load_config
    from slam_init.methods.registry import method_info

    config = load_config(config_path, {"method": arguments.method, "seed": arguments.seed})
    method_info(config.method)
    if arguments.realtime:  # without it the file decides
        config = replace(config, work_per_frame=REALTIME_WORK)
    if arguments.refine_focal:
        config = replace(config, map=replace(config.map, refine_focal=True))
    source = opened_source(arguments, config.seed)
    camera = chosen_camera(arguments, source, arguments.start)

    from slam_init.output.summary import summary_text
    from slam_init.runner import run

    _, summary = run(
        source,
        camera,
        config,
        out=out,
        start=arguments.start,
        max_frames=arguments.max_frames,
        continue_frames=arguments.continue_frames,
        progress=not arguments.quiet and sys.stderr.isatty(),
        overview=not arguments.no_overview,
    )
    if arguments.json:
        tell(summary_text(summary))
    elif not arguments.quiet:
        from slam_init.output.report import report_text

        tell(report_text(summary, out))
    return DONE if summary.reason is None else NOT_INITIALIZED
