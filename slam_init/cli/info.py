"""``slam-init info``."""

from __future__ import annotations

import argparse

from slam_init.cli.parser import DONE, Commands, add_command, add_source, chosen_camera, opened_source
from slam_init.system.process_io import emit
from slam_init.system.regular_file import user_path


def add_info(commands: Commands) -> None:
    """Add the command."""
    description = (
        "Tell what a sequence holds. For the folder of a run: the verdict and its reason, the keyframes, the files, "
        "the version and the command."
    )
    info = add_command(commands, "info", _info, "show what a sequence or the folder of a run holds", description)
    add_source(info, default=None, results=True)
    info.add_argument("--json", action="store_true", help="print it as JSON")


def _info(arguments: argparse.Namespace) -> int:
    """``slam-init info``."""
    from slam_init.output.plain_json import json_text
    from slam_init.output.report import is_result_folder, read_result, result_text

    folder = user_path(arguments.source)
    if is_result_folder(folder):
        facts = read_result(folder)
        text = result_text(facts)
    else:
        from slam_init.datasets.describe import describe, describe_text

        source = opened_source(arguments, 0)
        facts = describe(source, chosen_camera(arguments, source, 0))
        text = describe_text(facts)
    emit(json_text(facts, digits=17) if arguments.json else text)
    return DONE
