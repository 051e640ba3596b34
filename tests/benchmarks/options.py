"""What the programs share: options, one thread, output files, logs."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "TBB_NUM_THREADS")


def run_on_one_thread() -> None:
    """Restart the program with one thread, unless it runs with one thread already.

    The numerical libraries read their number of threads when they are loaded, and the package loads them before the
    code of a program runs.
    """
    if all(os.environ.get(name) == "1" for name in _THREADS):
        return
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def program(name: str, description: str) -> argparse.ArgumentParser:
    """The parser of the options of a program, with the option that all of them have."""
    parser = argparse.ArgumentParser(prog=f"python -m tests.benchmarks.{name}", allow_abbrev=False)
    parser.description = description.partition("\n")[0]
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    return parser


def progress(items: Iterable[T], unit: str, total: int | None = None) -> Iterator[T]:
    """Show on a terminal how many of some items are done."""
    from tqdm import tqdm

    yield from tqdm(items, unit=unit, total=total, disable=None, leave=False)


def data_folder() -> Path:
    """Return the folder of the real data: ``SLAM_INIT_DATA``, by default ``../shared/data``."""
    return Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))


def show(text: str, out: Path | None) -> None:
    """Print a text, and also write it to a file if one is given."""
    sys.stdout.write(text)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")


def append_row(log: Path | None, row: Any) -> None:
    """Add a dataclass as a line of JSON to a log, if one is given."""
    if log is not None:
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(row)) + "\n")


def read_rows(log: Path, kind: Callable[..., T]) -> list[T]:
    """The rows of a log, of one dataclass."""
    return [kind(**json.loads(line)) for line in log.read_text(encoding="utf-8").splitlines()]
