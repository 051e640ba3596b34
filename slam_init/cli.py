"""The command line: ``slam-init run``, ``slam-init synth``, ``slam-init info``, ``slam-init compare``.

Exit codes: 0 initialized (or done), 2 bad usage or input, 3 the data never allowed initialization. An interrupt gives
128 and the number of the signal: 130 for SIGINT, 143 for SIGTERM, 129 for SIGHUP. Whatever is wrong is told in one line
on stderr.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from slam_init.errors import CalibrationError, SlamInitError
from slam_init.process_io import InterruptsNoted, NativeStderrSilenced, complain, fill_closed_streams, tell
from slam_init.regular_file import user_path

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from slam_init.types.camera import Camera
    from slam_init.types.frame import Source

    _Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"

__all__ = ["entry_point", "main"]

_DONE, _BAD_INPUT, _NOT_INITIALIZED = 0, 2, 3
#: Added to the number of the signal.
_INTERRUPTED = 128
_DEFAULT_SOURCE = "synth:room"
_DEFAULT_OUT = "slam-init-out"
_DEFAULT_COMPARISON = "slam-init-compare"
_OUT_HELP = "results: a new or empty folder, or one of an earlier run of this command (default: %(default)s)"


class _UsageError(SlamInitError):
    """The command line itself is wrong."""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, told by :func:`main` like all others."""

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        tell(self.format_help())

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """Print the version; looked up only then, as the look-up costs more than the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import PackageNotFoundError, version

        try:
            tell(f"slam-init {version('slam-init')}\n")
        except PackageNotFoundError:
            raise _UsageError("the version is known once the package is installed: pip install .") from None
        parser.exit()


def entry_point() -> NoReturn:
    """The console script."""
    fill_closed_streams()
    code = main()
    if code > _INTERRUPTED:
        # Where an interrupt comes inside ``exec``, Python ends by SIGINT later, whatever the exit code.
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process by default.
    """
    interrupts = InterruptsNoted()
    try:
        with interrupts:
            try:
                arguments = _parser().parse_args(argv)
                with NativeStderrSilenced():
                    code: int = arguments.command(arguments)
            except Exception:
                # An extension module that is interrupted while it is imported raises an ImportError instead.
                if interrupts.seen is not None:
                    raise KeyboardInterrupt from None
                raise
    except SlamInitError as error:
        complain(f"error: {error}")
        return _BAD_INPUT
    except KeyboardInterrupt as interrupt:
        complain(str(interrupt) or "interrupted")
        return _INTERRUPTED + (interrupts.seen or signal.SIGINT)
    except SystemExit as done:  # --help and --version
        return int(done.code or 0)
    return code


def _parser() -> _Parser:
    parser = _Parser(
        prog="slam-init",
        description="Monocular SLAM initialization: from a video to a bundle-adjusted map, or why not.",
        epilog="Exit codes: 0 initialized or done, 2 bad input, 3 never initialized, 130 interrupted (128 + signal).",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="run, synth, info or compare")

    _add_run(commands)
    _add_synth(commands)
    _add_info(commands)
    _add_compare(commands)
    return parser


def _add_run(commands: _Commands) -> None:
    run = commands.add_parser("run", help="initialize from a sequence", allow_abbrev=False)
    run.description = "Read frames until a map is found; write it, and a recording of how, to a folder."
    run.set_defaults(command=_run)
    _add_source(run, default=_DEFAULT_SOURCE)
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
    run.add_argument("--json", action="store_true", help="print the summary as JSON and nothing else")
    run.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")


def _add_synth(commands: _Commands) -> None:
    synth = commands.add_parser("synth", help="write a synthetic sequence", allow_abbrev=False)
    synth.description = "Render a synthetic sequence into a folder in the layout of TUM RGB-D."
    synth.set_defaults(command=_synth)
    synth.add_argument("scene", metavar="NAME", help="room, wall, desk, corridor, ...; a wrong name lists all")
    synth.add_argument("--out", metavar="DIR", required=True, help="a new or empty folder, or one of an earlier synth")
    synth.add_argument("--seed", type=int, default=0, metavar="N", help="of the world (default: 0)")
    synth.add_argument("--frames", type=int, metavar="N", help="number of frames (default: 100)")


def _add_info(commands: _Commands) -> None:
    info = commands.add_parser("info", help="tell what a sequence holds", allow_abbrev=False)
    info.set_defaults(command=_info)
    _add_source(info, default=None)
    info.add_argument("--json", action="store_true", help="print it as JSON")


def _add_compare(commands: _Commands) -> None:
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
    compare.add_argument("--methods", metavar="A,B", help="of slam-init run --method (default: all that are installed)")
    compare.add_argument("--every", type=int, default=10, metavar="K", help="start at every K-th frame (default: 10)")
    compare.add_argument(
        "--min-left", type=int, default=3, metavar="N", help="start only where N frames are left (default: 3)"
    )
    compare.add_argument("--grid", type=int, default=0, metavar="N", help="add N point-level trials of each scene")
    compare.add_argument(
        "--limit-frames", type=int, default=150, metavar="N", help="a trial reads at most N frames (default: 150)"
    )
    compare.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a core)")
    compare.add_argument(
        "--backend", default="loky", metavar="NAME", help="loky (default), sequential or dask:ADDRESS of a scheduler"
    )
    compare.add_argument("--seed", type=int, default=0, metavar="N", help="of random draws (default: 0)")
    compare.add_argument("--time-limit", type=float, default=300.0, metavar="S", help="of a trial (default: 300 s)")
    compare.add_argument("--memory-limit", type=int, default=6000, metavar="MB", help="of a trial (default: 6000 MB)")
    compare.add_argument("--realtime", action="store_true", help="judge in slices, as for a camera that does not wait")
    compare.add_argument("--recordings", action="store_true", help="write a recording of each trial")
    compare.add_argument("--out", metavar="DIR", default=_DEFAULT_COMPARISON, help=_OUT_HELP)


def _add_source(parser: argparse.ArgumentParser, default: str | None) -> None:
    parser.add_argument(
        "source",
        metavar="SOURCE",
        nargs="?" if default else None,
        default=default,
        help="a folder (TUM, EuRoC, KITTI, images), a video, or synth:NAME"
        + (f" (default: {default})" if default else ""),
    )
    parser.add_argument("--camera", metavar="FILE", help="calibration; 'guess' guesses the focal length")
    parser.add_argument(
        "--readout",
        metavar="MS",
        help="readout of a rolling shutter in milliseconds, 0 for a global shutter; 25,up or 25,left where rows or "
        "columns are read in another direction than down; 'auto' estimates it (default: that of the calibration)",
    )


# -- commands ------------------------------------------------------------------------------------------


def _run(arguments: argparse.Namespace) -> int:
    """``slam-init run``."""
    _at_least("--start", arguments.start, 0)
    _at_least("--max-frames", arguments.max_frames, 1)
    _at_least("--continue", arguments.continue_frames, 0)
    _at_least("--seed", arguments.seed, 0)
    config_path = user_path(arguments.config) if arguments.config is not None else None
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import RUN_FILES

    inputs = [arguments.source, *(file for file in (arguments.camera, config_path) if file is not None)]
    out = chosen_folder(arguments.out, "run", RUN_FILES, inputs)

    from slam_init.config import REALTIME_WORK, load_config
    from slam_init.datasets import open_source
    from slam_init.methods.registry import method_info

    config = load_config(config_path, {"method": arguments.method, "seed": arguments.seed})
    method_info(config.method)
    if arguments.realtime:  # without it the file decides
        config = replace(config, work_per_frame=REALTIME_WORK)
    if arguments.refine_focal:
        config = replace(config, map=replace(config.map, refine_focal=True))
    source = open_source(arguments.source, config.seed)
    camera = _camera(arguments, source, arguments.start)
    if camera is None:
        raise CalibrationError(f"{arguments.source} has no calibration: give --camera FILE, or --camera guess")
    notes = (
        ("the focal length is a guess (1.2 times the longer image side): expect a bent map",) if camera.guessed else ()
    )

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
        notes=notes,
    )
    if arguments.json:
        tell(summary_text(summary))
    elif not arguments.quiet:
        from slam_init.output.report import report_text

        tell(report_text(summary, out))
    return _DONE if summary.reason is None else _NOT_INITIALIZED


def _synth(arguments: argparse.Namespace) -> int:
    """``slam-init synth``."""
    _at_least("--frames", arguments.frames, 1)
    _at_least("--seed", arguments.seed, 0)
    from slam_init.output.folder import OutputFolder, chosen_folder, output_error, staged_names

    out = chosen_folder(arguments.out, "synth")

    from tqdm import tqdm

    from sequences_synth import write_tum
    from slam_init.datasets.synth import make_synth

    values = {} if arguments.frames is None else {"frames": arguments.frames}
    sequence = make_synth(arguments.scene, arguments.seed, values)
    # disable=None: silent where stderr is no terminal.
    with tqdm(total=len(sequence), unit="frame", disable=None, leave=False) as bar:

        def advance(done: int) -> None:
            bar.update(done - bar.n)

        with OutputFolder(out, "synth") as folder:
            try:
                write_tum(sequence, folder.staging, progress=advance)
            except OSError as error:
                raise output_error(out, error) from error
            folder.publish(staged_names(folder), remove=folder.files)
    tell(f"wrote {len(sequence)} frames of {arguments.scene} to {out}\n")
    return _DONE


def _info(arguments: argparse.Namespace) -> int:
    """``slam-init info``."""
    from slam_init.datasets import open_source
    from slam_init.datasets.describe import describe, describe_text

    source = open_source(arguments.source)
    info = describe(source, _camera(arguments, source, 0))
    if arguments.json:
        import json
        from dataclasses import asdict

        tell(json.dumps(asdict(info), indent=2, allow_nan=False) + "\n")
    else:
        tell(describe_text(info))
    return _DONE


def _compare(arguments: argparse.Namespace) -> int:
    """``slam-init compare``."""
    for option, least in (("every", 1), ("min_left", 2), ("grid", 0), ("limit_frames", 2), ("jobs", 1), ("seed", 0)):
        _at_least(f"--{option.replace('_', '-')}", getattr(arguments, option), least)
    _at_least("--time-limit", arguments.time_limit, 1)
    _at_least("--memory-limit", arguments.memory_limit, 100)
    if not arguments.sources and not arguments.grid:
        raise _UsageError("no SOURCE: give sequences, or --grid N (see slam-init compare --help)")
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import COMPARE_FILES

    out = chosen_folder(arguments.out, "compare", COMPARE_FILES, arguments.sources)

    from slam_init.compare.command import run_command

    tell(run_command(arguments, out, progress=sys.stderr.isatty()))
    return _DONE


# -- checks --------------------------------------------------------------------------------------------


def _camera(arguments: argparse.Namespace, source: Source, start: int) -> Camera | None:
    """The calibration that was asked for, else that of the source; checked against the first image used."""
    frame = next(source.frames(start, 1))
    if arguments.camera is None:
        camera = source.camera
    else:
        from slam_init.calibration.files import load_camera

        camera = load_camera(arguments.camera, (frame.image.shape[1], frame.image.shape[0]))
    return camera if arguments.readout is None or camera is None else _with_readout(camera, arguments.readout)


def _with_readout(camera: Camera, text: str) -> Camera:
    """The camera with the readout of the command line."""
    if text == "auto":
        return replace(camera, readout_ms=None)
    milliseconds, _, direction = text.partition(",")
    try:
        return replace(camera, readout_ms=float(milliseconds), readout_direction=direction or "down")
    except ValueError:
        raise _UsageError(f"--readout is {text!r}: give milliseconds, as in 25 or 25,up, or auto") from None


def _at_least(option: str, value: float | None, least: int) -> None:
    if value is not None and value < least:
        raise _UsageError(f"{option} is {value}: it must be at least {least}")
