"""What the programs share: options, one thread, output files."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

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


def positive(text: str) -> int:
    """Parse a whole number from 1, for argparse."""
    value = int(text) if text.isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1")
    return value


def number_list(kind: Callable[[str], T], low: float, high: float) -> Callable[[str], list[T]]:
    """A parser for argparse: numbers of a range, separated by commas."""

    def parse(text: str) -> list[T]:
        try:
            values = [kind(item) for item in text.split(",")]
        except ValueError:
            values = []
        if not values or not all(low <= float(str(value)) <= high for value in values):
            raise argparse.ArgumentTypeError(f"{text!r}: give numbers from {low:g} to {high:g} between commas")
        return values

    return parse


def choice_list(allowed: Sequence[str]) -> Callable[[str], list[str]]:
    """A parser for argparse: names of a set, separated by commas."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        if unknown := [name for name in names if name not in allowed]:
            raise argparse.ArgumentTypeError(f"unknown {unknown[0]!r}: use {', '.join(allowed)}")
        return names

    return parse


def progress(items: Iterable[T], unit: str, total: int | None = None) -> Iterator[T]:
    """Show on a terminal how many of some items are done."""
    from tqdm import tqdm

    yield from tqdm(items, unit=unit, total=total, disable=None, leave=False)


def data_folder() -> Path:
    """Return the folder of the real data: ``SLAM_INIT_DATA``, by default ``../shared/data``."""
    return Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))


def show(text: str, out: str | os.PathLike[str] | None) -> None:
    """Print a text, and also write it to a file if one is given."""
    sys.stdout.write(text)
    if out is not None:
        Path(out).write_text(text, encoding="utf-8")


def save(out: Path | None, name: str, text: str) -> None:
    """Print a text, and also write it to a folder if one is given."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    show(text, None if out is None else out / name)
