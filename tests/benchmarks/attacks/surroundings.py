"""Attacks on the surroundings of a command: what a machine lacks, files that are damaged, processes that are killed."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

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
    waited,
)
from tests.benchmarks.attacks.folders import STILL
from tests.benchmarks.attacks.process_tree import MARK, left_over, new_mark, processes_with

_AREA = "surroundings"
_LINE = "one line, exit code 2"
_POINTS = "points:room?views=5&seed=1"
_RUN = ("run", STILL, "--quiet", "--no-overview", "--out", "out")
_COMPARE = ("compare", _POINTS, "--methods", "stella", "--out", "out")


def _variable(name: str, value: str, folder: Path) -> Seen:
    return one_line(command(*_RUN, folder=folder, environment={name: value}), 2, "numba does not start")


def _refused(arguments: Sequence[str], word: str, prepare: Callable[[Path], object], folder: Path) -> Seen:
    prepare(folder)
    return one_line(command(*arguments, folder=folder), 2, word)


def _in_shell(before: str, arguments: Sequence[str], folder: Path) -> Ended:
    """Run a command in a shell with mounts of its own, after something was done there."""
    words = shlex.join(program(arguments))
    return finished(started(["unshare", "-m", "sh", "-c", f"{before}; exec {words}"], folder))


def _read_only_shm(folder: Path) -> Seen:
    ended = _in_shell("mount -t tmpfs -o ro tmpfs /dev/shm", (*_COMPARE, "--backend", "loky", "--jobs", "2"), folder)
    return one_line(ended, 2, "--backend sequential")


def _few_files(folder: Path) -> Seen:
    """What loky needs more files for ends in one line; where they are enough, the comparison is complete."""
    ended = _in_shell("ulimit -n 14", (*_COMPARE, "--backend", "loky", "--jobs", "2"), folder)
    if ended.code == 0:
        return Seen((folder / "out" / "report.html").exists(), "complete")
    return one_line(ended, 2)


def _no_home(folder: Path) -> Seen:
    """Libraries have no place for their caches."""
    bare = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/proc/x", "MPLCONFIGDIR": "/proc/y"}
    ended = command("run", STILL, "--quiet", "--out", "out", folder=folder, environment=bare)
    return Seen(ended.code == 3 and not ended.err and not ended.out, f"exit code {ended.code}: {ended.err[-200:]}")


def _codec(folder: Path) -> object:
    """A Matroska file whose codec nobody knows."""
    import cv2

    path = folder / "v.mkv"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for seed in range(6):
        writer.write(np.random.default_rng(seed).integers(0, 255, (48, 64, 3), dtype=np.uint8))
    writer.release()
    data = path.read_bytes()
    return path.write_bytes(data.replace(b"V_MJPEG", b"V_QJPEG") if b"V_MJPEG" in data else data[:400])


def _fill_bytes(folder: Path) -> object:
    """A JPEG with 50 MB of fill bytes in its header."""
    import cv2

    data = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    (folder / "data").mkdir()
    (folder / "data" / "0.jpg").write_bytes(data[:2] + b"\xff" * 50_000_000 + data[2:])
    return (folder / "data" / "1.jpg").write_bytes(data)


def _thin(folder: Path) -> object:
    import cv2

    (folder / "data").mkdir()
    return [cv2.imwrite(str(folder / "data" / f"{k}.png"), np.zeros((2, 20_000), np.uint8)) for k in range(2)]


def _listed(lines: int, truth: str = "") -> Callable[[Path], object]:
    """A list of images with a number of lines, and ground truth."""

    def make(folder: Path) -> object:
        import cv2

        (folder / "data").mkdir()
        for k in range(3):
            cv2.imwrite(str(folder / "data" / f"{k}.png"), np.zeros((48, 64), np.uint8))
        (folder / "data" / "rgb.txt").write_text("".join(f"{0.1 * k:.1f} {k % 3}.png\n" for k in range(lines)))
        return truth and (folder / "data" / "groundtruth.txt").write_text(truth)

    return make


def _config(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "c.toml").write_text(text)


def _sheet(folder: Path) -> None:
    """A score sheet that is a link to a file of the user."""
    (folder / "theirs").mkdir()
    (folder / "secret.json").write_text("{}")
    (folder / "theirs" / "sheet.json").symlink_to(folder / "secret.json")


def _graph(change: Callable[[Path], object], folder: Path) -> Seen:
    """Read a damaged graph in a process of its own."""
    out = folder / "run"
    made = command("run", ROOM, "--quiet", "--out", "run", folder=folder)
    if made.code:
        return Seen(False, f"no map: exit code {made.code} {made.err[-100:]}")
    change(out)
    code = (
        "import sys, slam_init\ntry: slam_init.load_graph(sys.argv[1])\nexcept slam_init.SlamInitError as e: print(e)"
    )
    ended = finished(started([sys.executable, "-c", code, str(out)], folder))
    lines = ended.out.splitlines()
    return Seen(ended.code == 0 and len(lines) == 1 and not ended.err, f"{ended.code}: {lines[:1]}")


def _fifo(out: Path) -> None:
    (out / "graph.txt").unlink()
    os.mkfifo(out / "graph.txt")


def _zero(out: Path) -> None:
    (out / "values.txt").unlink()
    (out / "values.txt").symlink_to("/dev/zero")


def _word(index: int, text: str) -> Callable[[Path], object]:
    """Replace a word of the archive: word 9 is the number of factors."""

    def change(out: Path) -> object:
        words = (out / "graph.txt").read_text().split(" ")
        words[index] = text
        return (out / "graph.txt").write_text(" ".join(words))

    return change


def _bytes(data: bytes) -> Callable[[Path], object]:
    return lambda out: (out / "graph.txt").write_bytes(data)


def _swapped(out: Path) -> object:
    return shutil.copy(out / "values.txt", out / "graph.txt")


def _viewer_is_killed(number: signal.Signals, options: tuple[str, ...], folder: Path) -> Seen:
    """Kill ``view`` or ``run --live``: no viewer with its ports may be left."""
    if command("run", STILL, "--quiet", "--no-overview", "--out", "out", folder=folder).code != 3:
        return Seen(False, "no recording")
    mark = new_mark()
    environment: Mapping[str, str] = {**os.environ, MARK: mark}
    process = subprocess.Popen(
        program(("view", "out", *options)), cwd=folder, env=environment, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    began = time.monotonic()
    while len(processes_with(mark)) < 3 and process.poll() is None and not Pace.is_over(began, IN_TIME):
        time.sleep(0.05)
    time.sleep(1.0)
    count = len(processes_with(mark))
    process.send_signal(number)
    waited(process)
    left = left_over(mark, within_s=10)
    for each in left:
        os.kill(each, signal.SIGKILL)
    return Seen(count >= 3 and not left, f"{count} processes, {len(left)} left")


_NOTHING: Callable[[Path], object] = lambda folder: folder  # noqa: E731 (a default that does nothing)
_ROWS: tuple[tuple[str, Sequence[str], str, Callable[[Path], object]], ...] = (
    ("compare with --backend dask:nope", (*_COMPARE, "--backend", "dask:nope"), "'nope'", _NOTHING),
    ("a video of a codec that nobody knows", ("info", "v.mkv"), "v.mkv", _codec),
    ("a JPEG with 50 MB of fill bytes", ("info", "data"), "0.jpg", _fill_bytes),
    ("images of 20000x2", ("run", "data", "--out", "out"), "20000x2", _thin),
    ("a list of a million images", ("info", "data"), "split the sequence", _listed(1_000_000)),
    ("a true position of 1e300", ("info", "data"), "1e+300", _listed(3, "0.0 1e300 0 0 0 0 0 1\n")),
    ("a method of 41 letters", ("run", STILL, "--method", 41 * "a", "--out", "out"), "unknown method", _NOTHING),
    ("a distance of corners of 1e9", ("run", STILL, "--config", "c.toml"), "min_distance",
     _config("[tracking]\nmin_distance = 1e9\n")),
    ("a seed of 5,000 digits in a configuration", ("run", STILL, "--config", "c.toml"), "c.toml",
     _config(f"seed = 1{5000 * '0'}\n")),
    ("a seed of 5,000 digits", ("run", STILL, "--seed", f"1{5000 * '0'}"), "--seed", _NOTHING),
    ("a camera that is a bare number", ("run", STILL, "--camera", "615"), "f=615", _NOTHING),
    ("a method that is nearly one", ("run", STILL, "--method", "orbslam3"), "did you mean orb-slam3?", _NOTHING),
    ("a command that is nearly one", ("rum", STILL), "did you mean run?", _NOTHING),
    ("an option of a subcommand that is nearly one", ("view", "x", "--webb"), "slam-init view --help", _NOTHING),
    ("publish a sheet that is a link out of its folder", ("bench", "publish", "theirs"), "leads out", _sheet),
    ("--out of bytes that are no UTF-8", ("run", STILL, "--out", os.fsdecode(b"\xff\xfe")), "UTF-8", _NOTHING),
)  # fmt: skip

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    *(Attack(_AREA, name, _LINE, partial(_refused, words, word, make)) for name, words, word, make in _ROWS),
    *(
        Attack(_AREA, f"{name}={value}", _LINE, partial(_variable, name, value))
        for name, value in (("NUMBA_NUM_THREADS", "0"), ("NUMBA_NUM_THREADS", "-3"))
    ),
    Attack(_AREA, "compare where /dev/shm is read-only", _LINE, _read_only_shm),
    Attack(_AREA, "compare where 14 files may be open", "complete, or one line", _few_files),
    Attack(_AREA, "run --quiet without a home", "no word, exit code 3", _no_home),
    *(
        Attack(_AREA, f"load_graph: {name}", "an error of the package, in one line", partial(_graph, change))
        for name, change in (
            ("a named pipe", _fifo),
            ("a link to /dev/zero", _zero),
            ("a negative count", _word(9, "-3")),
            ("a count of 10^11", _word(9, str(10**11))),
            ("bytes that are no text", _bytes(b"\xff\xfe" * 100)),
            ("the values in place of the graph", _swapped),
            ("an empty file", _bytes(b"")),
        )
    ),
    *(
        Attack(
            _AREA,
            f"{number.name} to view {' '.join(options)}",
            "0 processes left",
            partial(_viewer_is_killed, number, options),
        )
        for number in (signal.SIGKILL, signal.SIGQUIT, signal.SIGTERM)
        for options in (("--web",), ("--screenshot", "v.png"))
    ),
)
