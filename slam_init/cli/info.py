"""``slam-init info``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from slam_init.cli.exit_codes import DONE
from slam_init.cli.source_options import add_source, chosen_camera, opened_source
from slam_init.process_io import tell

if TYPE_CHECKING:
    from slam_init.cli.parser import Commands

__all__ = ["add_info"]


def add_info(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse subparsers
    """
    info = commands.add_parser("info", help="tell what a sequence holds", allow_abbrev=False)
    info.set_defaults(command=_info)
    add_source(info, default=None)
    info.add_argument("--json", action="store_true", help="print it as JSON")


def _info(arguments: argparse.Namespace) -> int:
    """``slam-init info``."""
    from slam_init.datasets.describe import describe, describe_text

    source = opened_source(arguments, 0)
    info = describe(source, chosen_camera(arguments, source, 0))
    if arguments.json:
        import json
        from dataclasses import asdict

        tell(json.dumps(asdict(info), indent=2, allow_nan=False) + "\n")
    else:
        tell(describe_text(info))
    return DONE
