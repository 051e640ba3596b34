"""Hashes of everything that a set of runs writes: whether two versions of the code give the same results, to the byte.

The script uses the command line only, so that it runs on any version of the package::

    python -m tests.benchmarks.result_hashes --out after.json
    PYTHONPATH=OTHER_CHECKOUT python tests/benchmarks/result_hashes.py --out before.json
    python -m tests.benchmarks.result_hashes --compare before.json after.json

The runs: ``quest`` on the nine rendered worlds with three seeds and on each real sequence from five starts; every other
method on three worlds and three sequences. For each run the table holds the exit code, the SHA-256 of each result file,
and the figures of ``summary.json`` without what depends on the machine or the version.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypedDict

WORLDS = ("room", "wall", "nadir", "nadir-turn", "corridor", "desk", "rotation", "rotate-then-move", "static")
SEEDS = (0, 1, 2)
STARTS = 5
MAX_FRAMES = 90
#: A start that leaves fewer frames is not run.
MIN_FRAMES_LEFT = 3
OTHER_METHODS = (
    "quest-two-view",
    "orb-slam3",
    "orb-slam2",
    "stella",
    "colmap",
    "homography",
    "essential-5pt",
    "essential-8pt",
    "poselib",
)
OTHER_WORLDS = ("room", "wall", "corridor")
OTHER_SEQUENCES = ("tsukuba/new_tsukuba_150", "planar/checkerboard_desk", "kitti/06_start")
#: Results that must be equal to the byte.
FILES = (
    "trajectory.txt",
    "map.ply",
    "colmap/cameras.txt",
    "colmap/images.txt",
    "colmap/points3D.txt",
    "graph.txt",
    "values.txt",
    "continued.txt",
)
#: Keys of the summary that depend on the machine, or that name the version.
_NOT_COMPARED = ("timing_ms", "schema", "provenance")


class CaseResult(TypedDict):
    """What one run wrote; an entry of the table.

    ``sha256`` holds the hash of each result file by its name. ``summary`` is the content of ``summary.json`` without
    the keys that are not compared; it is empty if there is no such file.
    """

    exit_code: int
    stderr: str
    sha256: dict[str, str]
    summary: dict[str, object]


def cases(data: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of each run."""
    for world in WORLDS:
        for seed in SEEDS:
            yield f"quest synth:{world} seed {seed}", [f"synth:{world}", "--seed", str(seed)]
    lengths = {
        path.parent.relative_to(data).as_posix(): sum(
            1 for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")
        )
        for path in sorted(data.glob("*/*/rgb.txt"))
    }
    for name, length in lengths.items():
        last = max(length - MIN_FRAMES_LEFT, 0)
        for start in sorted({round(last * k / (STARTS - 1) * 0.8) for k in range(STARTS)}):
            yield f"quest {name} start {start}", [str(data / name), "--start", str(start)]
    for method in OTHER_METHODS:
        for world in OTHER_WORLDS:
            yield f"{method} synth:{world}", [f"synth:{world}", "--method", method]
        for name in OTHER_SEQUENCES:
            if name in lengths:
                yield f"{method} {name}", [str(data / name), "--method", method]


def run_case(arguments: list[str]) -> CaseResult:
    """Run one case in this process and return what it wrote."""
    from slam_init.cli import main

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
            code = main(["run", *arguments, "--max-frames", str(MAX_FRAMES), "--out", str(out), "--quiet"])
        hashes = {
            name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in FILES if (out / name).is_file()
        }
        summary = {}
        if (out / "summary.json").is_file():
            summary = json.loads((out / "summary.json").read_text())
            for key in _NOT_COMPARED:
                summary.pop(key, None)
        return {"exit_code": code, "stderr": errors.getvalue(), "sha256": hashes, "summary": summary}


def figures(summary: Mapping[str, object]) -> dict[str, object]:
    """All figures of a summary by path. Texts are left out: one may be reworded without a change of the result."""
    return _flat(summary, "")


def _flat(value: object, prefix: str) -> dict[str, object]:
    """Leaves of nested objects and lists by path, without texts that no decision depends on."""
    if isinstance(value, Mapping):
        return {k: v for key, item in value.items() for k, v in _flat(item, f"{prefix}{key}.").items()}
    if isinstance(value, list):
        return {k: v for i, item in enumerate(value) for k, v in _flat(item, f"{prefix}{i}.").items()}
    text = isinstance(value, str) and not prefix.endswith(("verdict.", "reason.", "kind.", "status."))
    return {} if text or value is None else {prefix: value}


def differences(before: Mapping[str, CaseResult], after: Mapping[str, CaseResult]) -> list[str]:
    """One line for each run whose exit code, files or figures differ."""
    lines = [f"{name}: only in one of the tables" for name in sorted(set(before) ^ set(after))]
    for name in sorted(set(before) & set(after)):
        old, new = before[name], after[name]
        if old["exit_code"] != new["exit_code"]:
            lines.append(f"{name}: exit code {old['exit_code']} became {new['exit_code']}")
        if old["sha256"] != new["sha256"]:
            lines.append(f"{name}: files differ")
        old_figures, new_figures = figures(old["summary"]), figures(new["summary"])
        changed = [key for key, value in old_figures.items() if new_figures.get(key) != value]
        if changed:
            lines.append(f"{name}: {len(changed)} figures of the summary differ, e.g. {', '.join(changed[:3])}")
    return lines


def main() -> int:
    """Run all cases, or compare two tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, help="table to write")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"), help="tables to compare")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes")
    options = parser.parse_args()
    if options.compare:
        before, after = (json.loads(path.read_text()) for path in options.compare)
        lines = differences(before, after)
        files = sum(len(entry["sha256"]) for entry in after.values())
        compared = sum(len(figures(entry["summary"])) for entry in before.values())
        print("\n".join(lines or ["no differences"]))
        print(f"{len(after)} runs, {files} files, {compared} figures of summaries; {len(lines)} differences")
        digest = hashlib.sha256(json.dumps({k: v["sha256"] for k, v in sorted(after.items())}).encode()).hexdigest()
        print(f"digest of all hashes: {digest}")
        return 1 if lines else 0
    if options.out is None:
        parser.error("give --out FILE or --compare BEFORE AFTER")
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[variable] = "1"
    data = Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))
    chosen = dict(cases(data))
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        results = dict(zip(chosen, pool.map(run_case, chosen.values()), strict=True))
    options.out.write_text(json.dumps(results, indent=1) + "\n")
    print(f"{len(results)} runs written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
