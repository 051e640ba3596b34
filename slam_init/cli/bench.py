"""``slam-init bench``."""

from __future__ import annotations

import argparse
import os
import sys

from slam_init.cli.parser import DONE, OUT_HELP, Commands, UsageError
from slam_init.cli.trial_options import add_methods, add_processes, check_trials
from slam_init.system.process_io import tell

_DEFAULT_OUT = "slam-init-bench"
_SUITES = ("drawn", "rendered", "video", "other")
_ACTIONS = ("publish", "list", "convert")


def add_bench(commands: Commands) -> None:
    """Add the command."""
    bench = commands.add_parser("bench", help="run InitBench, the benchmark of initialization", allow_abbrev=False)
    bench.description = (
        "Run InitBench: a fixed set of worlds or sequences, one score sheet. 'bench list' tells the suites and where "
        "to get the sequences. 'bench publish DIR...' makes a page from the results of several runs. 'bench convert "
        "LAYOUT FOLDER' makes a sequence from what its authors publish. docs/bench.md describes the protocol."
    )
    bench.set_defaults(command=_bench)
    bench.add_argument(
        "action", metavar="ACTION", nargs="*", help="nothing, list, publish DIR..., convert LAYOUT FOLDER"
    )
    bench.add_argument("--suite", choices=_SUITES, help="drawn (default), rendered, video or other")
    add_methods(bench)
    bench.add_argument("--worlds", type=int, metavar="N", help="number of worlds: 1000 drawn, 24 rendered, 60 other")
    bench.add_argument("--seed", type=int, default=0, metavar="N", help="of worlds and random draws (default: 0)")
    bench.add_argument("--every", type=int, metavar="K", help="start at every K-th frame of a sequence (default: 20)")
    bench.add_argument("--sequences", metavar="A,B", help="of the suite video (default: all at hand)")
    bench.add_argument("--generator", metavar="DIR", help="of the suite other: a folder with gen.py (docs/bench.md)")
    add_processes(bench)
    bench.add_argument(
        "--trajectories", action="store_true", help="write the trajectories in the formats of evo and VSLAM-LAB"
    )
    bench.add_argument("--out", metavar="DIR", default=_DEFAULT_OUT, help=OUT_HELP)


def _bench(arguments: argparse.Namespace) -> int:
    """``slam-init bench``."""
    action, *operands = arguments.action or [""]
    if action and action not in _ACTIONS:
        raise UsageError(f"unknown action {action!r}: give none, or {', '.join(_ACTIONS)} (see slam-init bench --help)")
    if action == "list":
        if operands:
            raise UsageError("bench list takes no further word")
        from slam_init.bench.command import list_text

        tell(list_text())
        return DONE
    if action == "publish":
        return _publish(operands, arguments.out)
    if action == "convert":
        return _convert(operands, arguments.out)
    return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    check_trials(arguments, worlds=1, every=1)
    suite = arguments.suite or "drawn"
    if suite != "video" and arguments.sequences is not None:
        raise UsageError("--sequences belongs to --suite video")
    if suite == "video" and arguments.worlds is not None:
        raise UsageError("--worlds belongs to --suite drawn, rendered and other: choose --sequences, or --every")
    if suite in ("drawn", "other") and arguments.every is not None:
        raise UsageError("--every belongs to --suite rendered and video: a drawn world has one trial")
    if (suite == "other") != bool(arguments.generator):
        raise UsageError("--suite other and --generator DIR belong together: give both, or none")
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import BENCH_FILES
    from slam_init.system.regular_file import user_path

    generator = user_path(arguments.generator) if arguments.generator else None
    out = chosen_folder(arguments.out, "bench", BENCH_FILES, [generator] if generator else ())

    from slam_init.bench.command import Execution, run_bench
    from slam_init.bench.protocol import DEFAULTS, Run
    from slam_init.compare.command import chosen_methods

    default = DEFAULTS[suite]
    run = Run(
        suite=suite,
        worlds=default.worlds if arguments.worlds is None else arguments.worlds,
        seed=arguments.seed,
        every=default.every if arguments.every is None else arguments.every,
        sequences=tuple(arguments.sequences.split(",")) if arguments.sequences else (),
        methods=chosen_methods(arguments.methods, arguments.method),
        generator=generator.resolve().name if generator else "",
    )
    execution = Execution(
        backend=arguments.backend,
        jobs=arguments.jobs or os.cpu_count() or 1,
        time_limit_s=arguments.time_limit,
        memory_limit_mb=arguments.memory_limit,
        trajectories=arguments.trajectories,
        progress=sys.stderr.isatty(),
    )
    tell(run_bench(run, out, execution, generator))
    return DONE


def _publish(folders: list[str], out_text: str) -> int:
    if not folders:
        raise UsageError("bench publish needs folders of results: slam-init bench publish DIR...")
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import PAGE

    out = chosen_folder(out_text, "bench publish", (PAGE,), folders)

    from slam_init.bench.leaderboard import publish

    tell(publish(folders, out))
    return DONE


def _convert(operands: list[str], out_text: str) -> int:
    if len(operands) != 2:
        raise UsageError("bench convert needs a layout and a folder: slam-init bench convert LAYOUT FOLDER --out DIR")
    layout, folder = operands
    from slam_init.output.folder import chosen_folder

    out = chosen_folder(out_text, "bench convert", (), [folder])

    from slam_init.bench.convert import convert

    tell(convert(layout, folder, out))
    return DONE
