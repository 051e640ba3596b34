"""Attacks on the outputs by disks that are full, read-only, limited or gone. The superuser may mount such disks."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.attacks.attack import (
    IN_TIME,
    ROOM,
    Attack,
    Ended,
    Pace,
    Seen,
    command,
    finished,
    one_line,
    program,
    started,
)
from tests.benchmarks.attacks.folders import STILL, contents, first_run, small_disk, still, verified

_AREA = "outputs"
_LONG = "synth:static?frames=250&width=320&height=240"
_POINTS = "points:room?views=5&seed=1"
#: From 16 kB to 4 MB, in steps of a constant factor.
_SIZES_KB = tuple(round(16 * 256 ** (step / 15)) for step in range(16))
_FULL = "exit code 0, or 2 with one line, in the time of eight runs"
_FULL_OVER = "exit code 0, or 2 with one line and the same earlier results, in the time of eight runs"


def _ends_well(ended: Ended, out: Path) -> Seen:
    """Judge a command on a small disk: complete results, or one line and none."""
    if ended.code == 0:
        sound = (out / "summary.json").exists() and verified(out / "recording.rrd")
        return Seen(sound, "exit code 0; the results are complete" if sound else "exit code 0; RESULTS ARE MISSING")
    return one_line(ended, 2, "make room")


def _empty_disk(size_kb: int, folder: Path) -> Seen:
    with small_disk(folder, f"size={size_kb}k") as disk:
        seen = _ends_well(command("run", ROOM, "--quiet", "--out", "disk/out", folder=folder), disk / "out")
        left = sorted(path.name for path in disk.iterdir())
        return seen if left in ([], ["out"]) else Seen(False, f"{seen.text}; left: {left}")


def _disk_with_results(free_kb: int, folder: Path) -> Seen:
    """Leave some space beside earlier results."""
    with small_disk(folder, "size=16m") as disk:
        if still(folder, out="disk/out").code != 3:
            return Seen(False, "no earlier results")
        used_kb = int(subprocess.run(["du", "-sk", disk], check=True, capture_output=True, text=True).stdout.split()[0])
        subprocess.run(["mount", "-o", f"remount,size={used_kb + free_kb}k", disk], check=True, capture_output=True)
        before = contents(disk / "out")
        ended = command("run", ROOM, "--quiet", "--out", "disk/out", folder=folder)
        seen = _ends_well(ended, disk / "out")
        if ended.code == 0:
            return seen
        same = contents(disk / "out") == before
        return Seen(seen.holds and same, f"{seen.text}; earlier results {'the same' if same else 'CHANGED'}")


def _comparison_resumes(size_kb: int, folder: Path) -> Seen:
    """A comparison meets a full disk; it resumes when there is room."""
    with small_disk(folder, f"size={size_kb}k") as disk:
        arguments = (
            "compare",
            _POINTS,
            "--methods",
            "stella",
            "--backend",
            "sequential",
            "--recordings",
            "--out",
            "disk/out",
        )
        first = command(*arguments, folder=folder)
        seen = one_line(first, 2, "make room")
        subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True, capture_output=True)
        second = command(*arguments, folder=folder)
        found = contents(disk / "out")
        errors = b'"outcome": "error"' in found.get("trials.jsonl", b"")
        holds = seen.holds and second.code == 0 and "report.html" in found and not errors
        return Seen(
            holds,
            f"{seen.text}; with room: exit code {second.code}" + ("; the disk counts as a method's error" * errors),
        )


def _synth(size_kb: int, folder: Path) -> Seen:
    with small_disk(folder, f"size={size_kb}k") as disk:
        seen = one_line(command("synth", "room", "--frames", "5", "--out", "disk/out", folder=folder), 2, "make room")
        left = list(disk.iterdir())
        return Seen(seen.holds and not left, f"{seen.text}; {len(left)} files left")


def _no_inodes(folder: Path) -> Seen:
    with small_disk(folder, "size=16m,nr_inodes=9") as disk:
        ended = command("run", ROOM, "--quiet", "--out", "disk/out", folder=folder)
        return _ends_well(ended, disk / "out")


def _read_only(arguments: tuple[str, ...]) -> Callable[[Path], Seen]:
    def attack(folder: Path) -> Seen:
        with small_disk(folder, "size=4m") as disk:
            (disk / "out").mkdir()
            subprocess.run(["mount", "-o", "remount,ro", disk], check=True, capture_output=True)
            return one_line(command(*arguments, "--out", "disk/out", folder=folder), 2, "permission")

    return attack


def _gone(folder: Path) -> Seen:
    return _during_a_run(folder, lambda disk: ["umount", "-l", str(disk)], "cannot write")


def _filled(folder: Path) -> Seen:
    """Another program fills the disk during a run."""
    fill = "cat /dev/zero > {} 2>/dev/null; true"
    return _during_a_run(folder, lambda disk: ["sh", "-c", fill.format(shlex.quote(f"{disk}/zeros"))], "make room")


def _during_a_run(folder: Path, change: Callable[[Path], list[str]], word: str) -> Seen:
    with small_disk(folder, "size=16m") as disk:
        process = started(program(("run", _LONG, "--quiet", "--out", "disk/out")), folder)
        recording = disk / "out" / ".slam-init" / "new" / "recording.partial.rrd"
        began = time.monotonic()
        while not recording.exists() and process.poll() is None and not Pace.is_over(began, IN_TIME):
            time.sleep(0.02)
        time.sleep(1.0)
        changed = subprocess.run(change(disk), check=False, capture_output=True, text=True)
        if changed.returncode:
            process.kill()
            process.communicate()
            return Seen(False, f"not tried: {changed.stderr.strip()}")
        return one_line(finished(process), 2, word)


def _limited(limit: str, source: str) -> Callable[[Path], Seen]:
    """Return an attack: the shell limits what the process may use."""

    def attack(folder: Path) -> Seen:
        first_run(folder)
        before = contents(folder / "out")
        words = shlex.join(program(("run", source, "--quiet", "--out", "out")))
        seen = one_line(finished(started(["bash", "-c", f"ulimit {limit}; exec {words}"], folder)), 2, "cannot write")
        same = contents(folder / "out") == before
        return Seen(seen.holds and same, f"{seen.text}; earlier results {'the same' if same else 'CHANGED'}")

    return attack


def _full_stdout(folder: Path) -> Seen:
    """The results are complete, and the summary cannot be printed."""
    words = shlex.join([sys.executable, "-m", "slam_init", "run", STILL, "--json", "--out", "out"])
    seen = one_line(finished(started(["sh", "-c", f"{words} > /dev/full"], folder)), 2, "standard output")
    return Seen(seen.holds and "summary.json" in contents(folder / "out"), seen.text)


def _with_size(attack: Callable[[int, Path], Seen], size_kb: int) -> Callable[[Path], Seen]:
    return lambda folder: attack(size_kb, folder)


_LINE = "one line, exit code 2"
_COMPARE = ("compare", _POINTS, "--methods", "stella")

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = tuple(
    Attack(_AREA, name, expected, attack)
    for name, expected, attack in (
        *((f"run on a disk of {size} kB", _FULL, _with_size(_empty_disk, size)) for size in _SIZES_KB),
        *(
            (f"run with {free} kB beside earlier results", _FULL_OVER, _with_size(_disk_with_results, free))
            for free in (0, 8, 64, 256, 1024, 1536, 2048, 4096)
        ),
        *(
            (
                f"compare on a disk of {size} kB, then with room",
                f"{_LINE}; resumes",
                _with_size(_comparison_resumes, size),
            )
            for size in (8, 24, 64, 128)
        ),
        *((f"synth on a disk of {size} kB", f"{_LINE}; no file", _with_size(_synth, size)) for size in (16, 1024)),
        ("run on a disk with 9 inodes", _FULL, _no_inodes),
        ("run on a read-only disk", _LINE, _read_only(("run", STILL))),
        ("compare on a read-only disk", _LINE, _read_only(_COMPARE)),
        ("the disk becomes full during a run", _LINE, _filled),
        ("the disk is unmounted during a run", _LINE, _gone),
        ("files of 100 kB at most (ulimit -f)", f"{_LINE}; earlier results the same", _limited("-f 100", ROOM)),
        ("standard output is full", f"{_LINE}; complete results", _full_stdout),
    )
)
