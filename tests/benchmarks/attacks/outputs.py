"""Attacks on the outputs: folders of others, results of earlier runs, links, and damaged marks."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.attacks.attack import Attack, Seen, command, one_line, program
from tests.benchmarks.attacks.folders import STILL, contents, first_run, refused, still, tree, verified

_AREA = "outputs"
_RUN = ("run", STILL, "--quiet", "--out")
_COMPARE = ("compare", "points:room?views=5&seed=1", "--methods", "stella", "--backend", "sequential", "--out")
_SYNTH = ("synth", "static", "--frames", "2", "--out")
_REFUSED = "one line, exit code 2; no file is changed"
_WORKS = "it works; files of others are not changed"


def _foreign(name: str, arguments: tuple[str, ...], *, out: str = "out") -> Callable[[Path], Seen]:
    """Return an attack: the folder holds a file that the program did not write."""

    def attack(folder: Path) -> Seen:
        path = folder / "out" / name
        path.parent.mkdir(parents=True)
        path.write_text("{}" if name.endswith(".json") else "mine")
        return refused(folder / "out" if out == "." else folder, (*arguments, out), "not empty")

    return attack


def _prepared(prepare: Callable[[Path], object], out: str, *words: str) -> Callable[[Path], Seen]:
    """Return an attack: a run is refused in a folder that was prepared."""

    def attack(folder: Path) -> Seen:
        prepare(folder)
        return refused(folder, (*_RUN, out), *words)

    return attack


def _after_a_run(
    prepare: Callable[[Path], object], *words: str, options: tuple[str, ...] = ()
) -> Callable[[Path], Seen]:
    """Return an attack: after a first run, something is done to its folder, and a second run is refused."""

    def attack(folder: Path) -> Seen:
        first_run(folder)
        prepare(folder)
        return refused(folder, ("run", STILL, "--quiet", *options, "--out", "out"), *words)

    return attack


def _other_command(first: tuple[str, ...], second: tuple[str, ...]) -> Callable[[Path], Seen]:
    def attack(folder: Path) -> Seen:
        command(*first, "out", folder=folder)
        return refused(folder, (*second, "out"), f"slam-init {first[0]}")

    return attack


def _writes(path: str, text: str = "mine") -> Callable[[Path], object]:
    def write(folder: Path) -> None:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)

    return write


def _links(link: str, aim: str) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        _writes("theirs/cameras.txt")(folder)
        place = folder / link
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.is_dir():
            shutil.rmtree(place)
        place.unlink(missing_ok=True)
        place.symlink_to(folder / aim)

    return make


def _lists(name: str) -> Callable[[Path], object]:
    """Return a preparation: the marker lists a further file."""

    def write(folder: Path) -> None:
        _writes("mine.txt")(folder)
        marker = folder / "out" / ".slam-init" / "files.json"
        content = json.loads(marker.read_text())
        marker.write_text(json.dumps(content | {"files": [*content["files"], name]}))

    return write


def _has_cameras(folder: Path) -> None:
    _lists("colmap/cameras.txt")(folder)
    _writes("out/colmap/cameras.txt")(folder)


def _pipe(path: str) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).unlink(missing_ok=True)
        os.mkfifo(folder / path)

    return make


_JOURNAL = json.dumps({"put": [], "remove": ["../mine.txt"], "command": "run", "version": "0", "files": []})


def _stays(folder: Path) -> Seen:
    """Files of the user lie beside the results."""
    first_run(folder)
    mine = {"notes.md": b"mine", "colmap/mine.txt": b"mine", ".hidden": b"mine"}
    for name, content in mine.items():
        (folder / "out" / name).parent.mkdir(exist_ok=True)
        (folder / "out" / name).write_bytes(content)
    code = still(folder).code
    after = contents(folder / "out")
    holds = code == 3 and {name: after.get(name) for name in mine} == mine
    return Seen(holds, f"exit code {code}; {len(mine)} files of the user are {'the same' if holds else 'CHANGED'}")


def _linked_result(folder: Path) -> Seen:
    """A result became a link to a file of the user."""
    first_run(folder)
    _writes("mine.txt")(folder)
    (folder / "out" / "config.toml").unlink()
    (folder / "out" / "config.toml").symlink_to(folder / "mine.txt")
    code = still(folder).code
    same = (folder / "mine.txt").read_text() == "mine"
    return Seen(code == 3 and same, f"exit code {code}; the aim of the link is {'the same' if same else 'CHANGED'}")


def _version_0_1(folder: Path) -> Seen:
    """A folder without a marker, as version 0.1 wrote it, with a file of the user."""
    first_run(folder)
    shutil.rmtree(folder / "out" / ".slam-init")
    (folder / "out" / "map.ply").write_text("of the earlier run")
    (folder / "out" / "notes.md").write_text("mine")
    code = still(folder).code
    after = set(contents(folder / "out"))
    holds = code == 3 and after == {"summary.json", "config.toml", "overview.png", "recording.rrd", "notes.md"}
    return Seen(holds, f"exit code {code}; {', '.join(sorted(after))}")


def _odd_name(name: str) -> Callable[[Path], Seen]:
    def attack(folder: Path) -> Seen:
        codes = [still(folder, out=name).code for _ in range(2)]
        found = sorted(contents(folder / name))
        return Seen(codes == [3, 3] and "summary.json" in found, f"exit codes {codes}; {len(found)} files")

    return attack


def _twice_at_once(folder: Path) -> Seen:
    """A second run starts while the first one writes to the folder."""
    first = _start("synth:static?frames=400&width=160&height=120", folder)
    try:
        if not _appears(folder / "out" / ".slam-init" / "new" / "recording.partial.rrd"):
            return Seen(False, "the first run did not start")
        seen = one_line(still(folder), 2, "in use")
    finally:
        first.send_signal(signal.SIGKILL)
        first.wait()
    code = still(folder).code
    return Seen(seen.holds and code == 3, f"{seen.text}; after the end of the first: exit code {code}")


def _interrupted(number: signal.Signals) -> Callable[[Path], Seen]:
    """Return an attack: a signal ends a run over earlier results."""

    def attack(folder: Path) -> Seen:
        first_run(folder)
        before = contents(folder / "out")
        process = _start("synth:static?frames=400&width=160&height=120", folder)
        running = _appears(folder / "out" / ".slam-init" / "new" / "recording.partial.rrd")
        time.sleep(1.5)
        process.send_signal(number)
        code = process.wait(30)
        after = contents(folder / "out")
        recording = after.pop("interrupted.rrd", None)
        told = f"exit code {code}; earlier results {'the same' if after == before else 'CHANGED'}"
        sound = True
        if number is not signal.SIGKILL:
            sound = recording is not None and verified(folder / "out" / "interrupted.rrd")
            told += f"; interrupted.rrd {'sound' if sound else 'BROKEN'}"
        again = still(folder).code
        left = sorted(set(contents(folder / "out")) ^ set(before))
        expected = -number if number is signal.SIGKILL else 128 + number
        holds = running and code == expected and after == before and sound and again == 3 and not left
        return Seen(holds, f"{told}; the next run: exit code {again}")

    return attack


def _killed_between_renames(folder: Path) -> Seen:
    """A journal says that half of the results were moved: the next run completes it first."""
    from slam_init.output.folder import OutputFolder

    out = folder / "out"
    first_run(folder)
    for name in ("new", "old"):
        (out / ".slam-init" / name).mkdir()
    names = ["map.ply", "config.toml", "summary.json"]
    for name in names[1:]:
        (out / ".slam-init" / "new" / name).write_text("new")
    (out / "map.ply").write_text("new")  # moved already
    (out / "summary.json").unlink()
    journal = {"put": names, "remove": ["recording.rrd"], "command": "run", "version": "0", "files": names}
    (out / ".slam-init" / "journal.json").write_text(json.dumps(journal))
    with OutputFolder(out, "run"):
        completed = contents(out) == dict.fromkeys(names, b"new")
    code = still(folder).code
    return Seen(completed and code == 3, f"completed: {completed}; the next run: exit code {code}")


def _synth_twice(folder: Path) -> Seen:
    codes = [command(*_SYNTH, "out", folder=folder).code, command(*_SYNTH[:3], "1", "--out", "out", folder=folder).code]
    images = len(list((folder / "out" / "images").iterdir()))
    return Seen(codes == [0, 0] and images == 1, f"exit codes {codes}; {images} image")


def _start(source: str, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        program(("run", source, "--quiet", "--out", "out")), cwd=folder,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def _appears(path: Path, within_s: float = 40.0) -> bool:
    end = time.monotonic() + within_s
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.02)
    return path.exists()


def _data_folder(folder: Path) -> Seen:
    """The results would land on the data."""
    command(*_SYNTH, "data", folder=folder)
    before = tree(folder)
    seen = [refused(folder, ("run", "data", "--out", out)) for out in ("data", "data/images", ".")]
    same = tree(folder) == before
    return Seen(all(one.holds for one in seen) and same, " / ".join(one.text for one in seen)[:300])


#: In the order of the table.
ATTACKS: tuple[Attack, ...] = tuple(
    Attack(_AREA, name, expected, attack)
    for name, expected, attack in (
        ("run --out . beside a trajectory.txt", _REFUSED, _foreign("trajectory.txt", _RUN, out=".")),
        ("run --out . beside a config.toml", _REFUSED, _foreign("config.toml", _RUN, out=".")),
        ("run into a folder with a summary.json of another program", _REFUSED, _foreign("summary.json", _RUN)),
        ("run into a git repository without files", _REFUSED, _foreign(".git/config", _RUN)),
        ("run into a folder with a recordings/ of the user", _REFUSED, _foreign("recordings/mine.rrd", _RUN)),
        ("compare into a folder with a report.html", _REFUSED, _foreign("report.html", _COMPARE)),
        ("compare into a folder with a trials.jsonl of the user", _REFUSED, _foreign("trials.jsonl", _COMPARE)),
        ("synth into a folder with images", _REFUSED, _foreign("images/000000.png", _SYNTH)),
        ("run into the folder of its data, its images, and above", _REFUSED, _data_folder),
        ("run into results of compare", _REFUSED, _other_command(_COMPARE, _RUN)),
        ("compare into results of run", _REFUSED, _other_command(_RUN, _COMPARE)),
        ("run into a sequence of synth", _REFUSED, _other_command(_SYNTH, _RUN)),
        ("--out is a file", _REFUSED, _prepared(_writes("out"), "out", "is a file")),
        ("--out is below a file", _REFUSED, _prepared(_writes("file"), "file/out", "is a file")),
        ("--out is a pipe", _REFUSED, _prepared(_pipe("out"), "out", "give a folder")),
        ("--out is a device", _REFUSED, _prepared(_writes("x"), "/dev/null", "give a folder")),
        ("--out is a link to itself", _REFUSED, _prepared(_links("out", "out"), "out", "--out")),
        ("--out is a link to a folder of the user", _REFUSED, _prepared(_links("out", "theirs"), "out", "not empty")),
        ("--out is a dangling link", _REFUSED, _prepared(_links("out", "nowhere"), "out", "--out")),
        ("--out is 300 characters long", _REFUSED, _prepared(_writes("x"), 300 * "a", "--out")),
        ("--config is the config.toml of --out", _REFUSED,
         _after_a_run(_writes("x"), "would replace", options=("--config", "out/config.toml"))),
        ("--config is a link to the config.toml of --out", _REFUSED,
         _after_a_run(_links("c.toml", "out/config.toml"), "would replace", options=("--config", "c.toml"))),
        ("--camera is the colmap/cameras.txt of --out", _REFUSED,
         _after_a_run(_has_cameras, "would replace", options=("--camera", "out/colmap/cameras.txt"))),
        ("the user put a map.ply beside results", _REFUSED, _after_a_run(_writes("out/map.ply"), "map.ply")),
        ("the user put a folder values.txt", _REFUSED, _after_a_run(_writes("out/values.txt/mine"), "values.txt")),
        ("colmap/ is a link out of the folder", _REFUSED, _after_a_run(_links("out/colmap", "theirs"), "link")),
        ("the marker lists ../mine.txt", _REFUSED, _after_a_run(_lists("../mine.txt"), "damaged")),
        ("the marker lists /etc/hosts", _REFUSED, _after_a_run(_lists("/etc/hosts"), "damaged")),
        ("the marker lists a name with a null byte", _REFUSED, _after_a_run(_lists("a\0"), "damaged")),
        ("the marker is cut", _REFUSED, _after_a_run(_writes("out/.slam-init/files.json", '{"sch'), "damaged")),
        ("the marker is 100,000 brackets", _REFUSED,
         _after_a_run(_writes("out/.slam-init/files.json", 100_000 * "["), "damaged")),
        ("the journal removes ../mine.txt", _REFUSED,
         _after_a_run(_writes("out/.slam-init/journal.json", _JOURNAL), "damaged")),
        ("the hidden folder is a link", _REFUSED, _after_a_run(_links("out/.slam-init", "theirs"), "--out")),
        ("files of the user lie beside the results", _WORKS, _stays),
        ("a result became a link to a file of the user", _WORKS, _linked_result),
        ("results of version 0.1, and a file of the user", _WORKS, _version_0_1),
        ("--out has a line break", _WORKS, _odd_name("a\nb")),
        ("--out has right-to-left characters and spaces", _WORKS, _odd_name(" \u202e\u05d0\u05d1 ")),
        ("--out begins with a hyphen", _WORKS, _odd_name("./-out")),
        ("synth twice into one folder", "the second replaces the first", _synth_twice),
        ("a second run while the first one writes", "one line, exit code 2; works after its end", _twice_at_once),
        ("a run that was killed between its renames", "the next command completes them", _killed_between_renames),
        *(
            (f"{number.name} to a run over earlier results", "earlier results the same; the recording so far is sound",
             _interrupted(number))
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
        ),
    )
)  # fmt: skip
