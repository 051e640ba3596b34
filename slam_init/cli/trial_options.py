"""The options of the commands that run many trials: methods, processes and limits."""

from __future__ import annotations

import argparse

from slam_init.cli.parser import ListMethods, at_least


def add_methods(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose the methods."""
    parser.add_argument("--methods", metavar="A,B", help="of slam-init run --method (default: all that are installed)")
    parser.add_argument(
        "--method",
        metavar="NAME",
        action="append",
        default=[],
        help="a further method; may be repeated. NAME=command:'PROGRAM {images} {times} {camera} {out}' is an external "
        "program (docs/bench.md)",
    )
    parser.add_argument("--list-methods", action=ListMethods, nargs=0, help="list the methods, one a line, and exit")


def add_processes(parser: argparse.ArgumentParser) -> None:
    """Add the options of the processes and of their limits."""
    parser.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a core)")
    parser.add_argument(
        "--backend", default="loky", metavar="NAME", help="loky (default), sequential or dask:ADDRESS of a scheduler"
    )
    parser.add_argument("--time-limit", type=float, default=300.0, metavar="S", help="of a trial (default: 300 s)")
    parser.add_argument("--memory-limit", type=int, default=6000, metavar="MB", help="of a trial (default: 6000 MB)")


def check_trials(arguments: argparse.Namespace, **least: int) -> None:
    """Check the numbers of the options above, and others: the least value of each by its name."""
    for name, smallest in {**least, "seed": 0, "jobs": 1, "time_limit": 1, "memory_limit": 100}.items():
        at_least(f"--{name.replace('_', '-')}", getattr(arguments, name), smallest)
