"""``slam-init join``."""

from __future__ import annotations

import argparse
import json

from slam_init.cli.parser import DONE, NOT_INITIALIZED, Commands
from slam_init.system.process_io import tell
from slam_init.system.regular_file import user_path


def add_join(commands: Commands) -> None:
    """Add the command."""
    join = commands.add_parser("join", help="find the similarity between two maps of a place", allow_abbrev=False)
    join.description = (
        "Find the scale, rotation and translation that bring the second map to the first, with the risk that they are "
        "chance. Exit codes: 0 joined, 3 not joined, 2 bad input."
    )
    join.set_defaults(command=_join)
    for name in ("first", "second"):
        join.add_argument(name, metavar="MAP", help="handover.npz, or the folder of a run or of a segment")
    join.add_argument("--json", action="store_true", help="print it as JSON")


def _join(arguments: argparse.Namespace) -> int:
    """``slam-init join``."""
    from slam_init.datasets.place_file import load_place
    from slam_init.mapping.joining import join
    from slam_init.output.plain_json import plain_fields

    found = join(load_place(user_path(arguments.first)), load_place(user_path(arguments.second)))
    tell(json.dumps(plain_fields(found), indent=2, allow_nan=False) + "\n" if arguments.json else f"{found}\n")
    return DONE if found else NOT_INITIALIZED
