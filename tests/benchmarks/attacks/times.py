"""Attacks on the readers by time stamps: each reader with each unit, and with what is no time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tests.benchmarks.attacks.attack import Attack, Seen, command, one_line
from tests.benchmarks.attacks.hostile_files import folder_of_images, tum_folder, written

_UNITS = {"seconds": 1, "milliseconds": 10**3, "microseconds": 10**6, "nanoseconds": 10**9}
_IMPOSSIBLE = {
    "repeated": (("5", "5", "6"), "does not come after"),
    "not increasing": (("5", "7", "6"), "does not come after"),
    "NaN": (("5", "nan", "7"), "expected"),
    "negative": (("-2", "-1", "0"), "negative"),
    "beyond 2^63": (("9223372036854775808", "9223372036954775808", "9223372037054775808"), "2^63"),
}


def _kitti(folder: Path, stamps: Sequence[str]) -> Path:
    folder_of_images(folder / "image_0")
    written(folder / "times.txt", "".join(f"{stamp}\n" for stamp in stamps))
    return folder


def _euroc(folder: Path, stamps: Sequence[str]) -> Path:
    folder_of_images(folder / "mav0" / "cam0" / "data")
    rows = "".join(f"{stamp},{i}.png\n" for i, stamp in enumerate(stamps))
    written(folder / "mav0" / "cam0" / "data.csv", f"#timestamp [ns],filename\n{rows}")
    return folder


_READERS: dict[str, Callable[[Path, Sequence[str]], Path]] = {"TUM": tum_folder, "KITTI": _kitti, "EuRoC": _euroc}


def _converted(make: Callable[[Path, Sequence[str]], Path], unit: str, *, told: bool) -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        begin_us = 1_403_636_579_750_000
        stamps = [begin_us + 50_000 * i for i in range(3)]
        texts = [f"{t / 1e6:.6f}" if unit == "seconds" else str(t * _UNITS[unit] // 10**6) for t in stamps]
        ended = command("info", make(folder / "data", texts), folder=folder)
        text = " ".join(ended.out.split())
        holds = ended.code == 0 and "0.10 s at 20 frames" in text and (f"taken as {unit}" in text) == told
        return Seen(holds, text[:200] or ended.err[:200])

    return run


def _refused(make: Callable[[Path, Sequence[str]], Path], stamps: Sequence[str], word: str) -> Callable[[Path], Seen]:
    return lambda folder: one_line(command("info", make(folder / "data", stamps), folder=folder), 2, word)


def _names(folder: Path) -> Seen:
    data = folder_of_images(folder / "data", [f"{1403636579750 + 50 * i}.png" for i in range(3)])
    ended = command("info", data, folder=folder)
    text = " ".join(ended.out.split())
    return Seen("0.10 s at 20 frames" in text and "taken as milliseconds" in text, text[:200])


#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    *(
        Attack(
            "times",
            f"{reader}: stamps in {unit}",
            "converted, and told where it is not the unit of the format",
            _converted(make, unit, told=unit != ("nanoseconds" if reader == "EuRoC" else "seconds")),
        )
        for reader, make in _READERS.items()
        for unit in _UNITS
    ),
    *(
        Attack("times", f"{reader}: stamps {what}", "exit code 2, one line that says so", _refused(make, stamps, word))
        for reader, make in _READERS.items()
        for what, (stamps, word) in _IMPOSSIBLE.items()
    ),
    Attack("times", "names of images that are dates in milliseconds", "converted, and told", _names),
)
