"""``slam-init compare``."""

from __future__ import annotations

import argparse
import os
import shlex
import sys

from slam_init.cli import parser
from slam_init.cli.parser import UsageError
from slam_init.system.process_io import emit

_DEFAULT_COMPARISON = "slam-init-compare"
#: A suite fixes these options, which have these defaults.
_FIXED = {
    "every": 10, "use_every": 1, "fps": None, "mask": None, "camera": None, "min_left": 3, "limit_frames": 150,
    "seed": 0,
}  # fmt: skip
_TYPES = {
    "--every": parser.number(1),
    "--use-every": parser.number(1),
    "--fps": float,
    "--min-left": parser.number(2),
    "--limit-frames": parser.number(2),
    "--jobs": parser.number(1),
    "--time-limit": parser.number(1, float),
    "--memory-limit": parser.number(100),
    "--seed": parser.number(0),
}
_OPTIONS = {
    "--methods A,B": "of slam-init run --method (default: all that are installed)",
    "--every K": "start at every K-th frame (default: 10)",
    "--use-every N": "use every N-th frame of each sequence",
    "--fps F": "use the frames nearest to F a second, by their times",
    "--mask PATH": parser.MASK,
    "--camera FILE": f"{parser.CAMERA}; 'auto' estimates it; for all sources (default: that of each source)",
    "--min-left N": "start only where N frames are left (default: 3)",
    "--limit-frames N": "a trial reads at most N frames (default: 150)",
    "--jobs N": "processes (default: one a core)",
    "--backend NAME": "dask:ADDRESS of a scheduler (default: processes of this machine)",
    "--time-limit S": "of a trial (default: 300 s)",
    "--memory-limit MB": "of a trial (default: 6000 MB)",
    "--seed N": "of random draws (default: 0)",
    **parser.TOPICS,
    "--audit": "state the risk of the map of each trial (see slam-init audit)",
    "--out DIR": parser.OUT_HELP,
}


def add_compare(commands: parser.Commands) -> None:
    """Add the command."""
    description = (
        "Run methods on the same tracks from many starts; write tables, statistics and a report. The wait of a trial "
        "is the number of frames after its start until the first correct map; a trial without one counts as its limit. "
        "slam_init/compare/criteria.py states how each sequence is evaluated."
    )
    compare = parser.add_command(commands, "compare", _compare, "compare methods on the same trials", description)
    compare.add_argument(
        "sources",
        metavar="SOURCE",
        nargs="*",
        type=parser.sequence_name,
        help="a sequence, a video, a folder of sequences, synth:NAME[?seed=N&...] or points:NAME[?seed=N&...]",
    )
    compare.add_argument(
        "--suite",
        choices=("simulated", "rendered"),
        help="in place of sources: frozen worlds, starts and seeds, so that figures can be cited "
        "(docs/measurements/simulated.md)",
    )
    compare.add_argument(
        "--method",
        metavar="NAME",
        action="append",
        default=[],
        help="a further method; may be repeated. NAME=command:'PROGRAM {images} {times} {camera} {out}' is an external "
        "program (docs/tutorials/compare.md)",
    )
    parser.add_list_methods(compare)
    parser.add_options(
        compare, _OPTIONS, _TYPES, **_FIXED, time_limit=300.0, memory_limit=6000, out=_DEFAULT_COMPARISON
    )


def _compare(arguments: argparse.Namespace) -> int:
    """``slam-init compare``."""
    _check_suite(arguments)
    from slam_init.output.folder import chosen_folder

    view = parser.calibrated_view_of(arguments, arguments.use_every)
    inputs = [*arguments.sources, *(file for file in (view.mask, view.camera) if file is not None)]
    out = chosen_folder(arguments.out, "compare", inputs)

    from slam_init.compare.report import main_table
    from slam_init.compare.run import chosen_methods, compare
    from slam_init.compare.sources import describe_sources
    from slam_init.compare.suites import SUITES
    from slam_init.compare.trials import Plan, Settings

    frozen = SUITES[arguments.suite] if arguments.suite else None
    sources = frozen.worlds if frozen else [parser.with_topics(arguments, source) for source in arguments.sources]
    settings = Settings(
        seed=arguments.seed,
        limit_frames=arguments.limit_frames,
        time_limit_s=arguments.time_limit,
        memory_limit_mb=arguments.memory_limit,
        audit=arguments.audit,
    )
    plan = Plan(
        tuple(describe_sources(sources, view)),
        chosen_methods(arguments.methods, arguments.method),
        frozen.every if frozen else arguments.every,
        frozen.min_left if frozen else arguments.min_left,
        settings,
    )
    summary, notes = compare(
        plan,
        out,
        backend=arguments.backend,
        jobs=arguments.jobs or os.cpu_count() or 1,
        progress=sys.stderr.isatty(),
        command=shlex.join(["slam-init", *sys.argv[1:]]),
        frozen=frozen,
    )
    text = "".join(f"{note}\n" for note in notes)
    emit(f"{main_table(summary)}\n\n{text}report: {out / 'report.html'}\n")
    return parser.DONE


def _check_suite(arguments: argparse.Namespace) -> None:
    """Refuse a command without sources, and what a suite fixes."""
    if arguments.suite is None:
        if not arguments.sources:
            raise UsageError("no SOURCE: give sequences, or --suite NAME (see slam-init compare --help)")
        return
    if arguments.sources:
        raise UsageError(f"--suite {arguments.suite} has its own sources: leave {arguments.sources[0]} out")
    parser.refuse_changed(arguments, _FIXED, f"--suite {arguments.suite} fixes")
