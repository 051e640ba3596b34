"""``slam-init synth``."""

from __future__ import annotations

import argparse

from slam_init.cli.parser import DONE, Commands, add_command, number
from slam_init.errors import ConfigError
from slam_init.system.process_io import emit


def add_synth(commands: Commands) -> None:
    """Add the command."""
    description = "Render a synthetic sequence into a folder in the layout of TUM RGB-D."
    synth = add_command(commands, "synth", _synth, "write a synthetic sequence", description)
    synth.add_argument(
        "scene",
        metavar="NAME",
        help="room, wall, desk, ..., or with options 'room?lens=fisheye'; a wrong name lists all",
    )
    synth.add_argument("--out", metavar="DIR", required=True, help="a new or empty folder, or one of an earlier synth")
    synth.add_argument("--seed", type=number(0), default=0, metavar="N", help="of the world (default: 0)")
    synth.add_argument("--frames", type=number(1), metavar="N", help="number of frames (default: 100)")


def _synth(arguments: argparse.Namespace) -> int:
    """``slam-init synth``."""
    from slam_init.output.folder import OutputFolder, chosen_folder, writing

    out = chosen_folder(arguments.out, "synth")

    from tqdm import tqdm

    from sequences_synth import SynthOptions, write_tum
    from slam_init.datasets.synth import make_synth, option_values

    name, _, query = arguments.scene.partition("?")
    values = option_values(arguments.scene, query, SynthOptions())
    if values.get("imu"):
        raise ConfigError("a written sequence has no inertial sensor: use slam-init run 'synth:NAME?imu=1' --scale imu")
    if arguments.frames is not None:
        values["frames"] = arguments.frames
    sequence = make_synth(name, arguments.seed, values)
    # disable=None: silent where stderr is no terminal.
    with tqdm(total=len(sequence), unit="frame", disable=None, leave=False) as bar:

        def advance(done: int) -> None:
            bar.update(done - bar.n)

        with OutputFolder(out, "synth") as folder:
            with writing(out):
                write_tum(sequence, folder.staging, progress=advance)
            folder.publish()
    emit(f"wrote {len(sequence)} frames of {arguments.scene} to {out}\n")
    return DONE
