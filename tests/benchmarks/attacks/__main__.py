"""Attacks that take a process or a disk of their own: performs them, and writes their table.

Hostile files, folders and arguments are tests of the readers and of :mod:`slam_init.output.folder`.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from slam_init.output.tables import markdown_table
from tests.benchmarks.attacks import disks, processes, surroundings
from tests.benchmarks.attacks.attack import Attack, Pace, Seen
from tests.benchmarks.options import progress, show

_ALL = (*disks.ATTACKS, *processes.ATTACKS, *surroundings.ATTACKS)


def main() -> int:
    """Perform the attacks."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks", description=__doc__)
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to this file too")
    parser.add_argument("--only", default="", metavar="TEXT", help="only attacks whose area or name contains it")
    parser.add_argument("--list", action="store_true", help="list the attacks, and perform none")
    arguments = parser.parse_args()
    # A job in the background, or under nohup, ignores these signals, and so would the processes that are attacked.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in ("SIGHUP", "SIGTERM", "SIGQUIT"):
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    chosen = [attack for attack in _ALL if arguments.only in f"{attack.area} {attack.name}"]
    if arguments.list:
        for attack in chosen:
            print(f"{attack.area}: {attack.name}")
        return 0
    if chosen:
        Pace.run_s()
    done = [(attack, *_performed(attack)) for attack in progress(chosen, "attack")]
    table = _table(done)
    show(table, arguments.out)
    return 0 if all(seen.holds for _, seen, _ in done) else 1


def _performed(attack: Attack) -> tuple[Seen, float]:
    """What was seen, and the seconds that it took."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            seen = attack.run(Path(folder))
        except Exception as error:  # what the project lets through is the finding
            seen = Seen(holds=False, text=f"{type(error).__name__}: {error}"[:300])
    seconds = time.monotonic() - began
    if Pace.is_over(began, attack.limit_runs):
        seen = Seen(holds=False, text=f"{seen.text} (longer than {attack.limit_runs:g} runs)")
    return seen, seconds


def _table(done: Sequence[tuple[Attack, Seen, float]]) -> str:
    held = sum(seen.holds for _, seen, _ in done)
    areas = []
    for area in dict.fromkeys(attack.area for attack, _, _ in done):
        holds = [seen.holds for attack, seen, _ in done if attack.area == area]
        areas.append([area, *(str(count) for count in (len(holds), sum(holds), len(holds) - sum(holds)))])
    rows = []
    for attack, seen, seconds in done:
        cells = (attack.area, attack.name, attack.expected, seen.text, "yes" if seen.holds else "NO", f"{seconds:.1f}")
        rows.append([" ".join(cell.replace("|", "\\|").split()) for cell in cells])
    return "\n\n".join(
        [
            f"{held} of {len(done)} attacks hold.",
            markdown_table(["area", "attacks", "held", "fallen"], areas),
            markdown_table(["area", "attack", "expected", "seen", "holds", "seconds"], rows) + "\n",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
