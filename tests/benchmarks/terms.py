"""What each term of the risk refuses: windows that all other terms together would accept.

Each world goes through an :class:`~slam_init.initializer.Initializer`. For each judged window, every term is noted; the
camera that rotates and zooms only where the sum of the others is small. A term that alone refuses no wrong window is
not needed. What a term costs are the right windows that it alone refuses; a later frame may still bring their map. ::

    python -m tests.benchmarks.terms --worlds PATH/gen.py --seeds 2000 2350 --log terms.jsonl
    python -m tests.benchmarks.terms --from-log terms.jsonl
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from slam_init.config import AcceptanceConfig
from slam_init.decision import window_rule
from slam_init.initializer import Initializer
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.risk import WindowRisk, risk_of, with_zooming_rotation
from tests.benchmarks.options import show
from tests.benchmarks.reliability import World, errors_of_poses_deg, is_wrong, worlds_of
from tests.benchmarks.tables import markdown_table

#: Terms by their names in a log, with what they are called; three are parts of the direction, whose other parts stay.
_TERMS = {
    "dir": "direction",
    "rot": "rotation",
    "oth": "another motion of other tracks",
    "riv": "rival",
    "rigid": "direction: bodies and errors that neighbours share",
    "fix": "direction: a lens that changes from view to view",
    "lens": "direction: the lens that a map holds",
    "zrot": "rotation: with zooms",
}
_PARTS_OF_DIRECTION = ("rigid", "fix", "lens")


def windows_of(world: World) -> list[dict[str, Any]]:
    """The judged windows of a world: whether their best motion is wrong, and their terms."""
    found: list[dict[str, Any]] = []
    initializer = Initializer(world.camera)
    with _noting(world, found):
        for view in world.views:
            if initializer.process_tracks(view):
                break
    return found


@contextmanager
def _noting(world: World, found: list[dict[str, Any]]) -> Iterator[None]:
    def noted(hypotheses: WindowHypotheses, max_risk: float) -> WindowRisk:
        best, risk = hypotheses.motions[0], risk_of(hypotheses, max_risk)
        whole, term = with_zooming_rotation(hypotheses, risk) if risk.total <= max_risk else risk, risk.directions
        errors = errors_of_poses_deg({k: best.motion.cam_from_world[k] for k in best.frames}, world.world_from_cam)
        row: dict[str, Any] = {"wrong": is_wrong(errors, world), "tot": whole.total}
        row |= {"dir": risk.direction, "rot": risk.rotation, "riv": risk.rival, "oth": risk.moving}
        row |= {"rigid": term.if_rigid, "fix": term.if_lens_fixed, "lens": term.if_lens_right}
        found.append(row | {"zrot": whole.rotation - risk.rotation})
        return whole

    with mock.patch.object(window_rule, "_complete_risk", noted):
        yield


def refuses_alone(term: str, window: Mapping[str, Any], max_risk: float) -> bool:
    """Whether a window is refused, and would not be without a term."""
    share = window["dir"] - min(window["dir"], window[term]) if term in _PARTS_OF_DIRECTION else window[term]
    return bool(window["tot"] > max_risk >= window["tot"] - share)


def report(worlds: Sequence[Sequence[Mapping[str, Any]]]) -> str:
    """The table of the worlds in which each term alone refuses a window."""
    max_risk = AcceptanceConfig().max_risk
    windows = [window for world in worlds for window in world]
    wrong = sum(bool(window["wrong"]) for window in windows)
    rows = []
    for term, name in _TERMS.items():
        counts = [
            sum(any(w["wrong"] == is_wrong and refuses_alone(term, w, max_risk) for w in world) for world in worlds)
            for is_wrong in (True, False)
        ]
        rows.append([name, *map(str, counts)])
    header = ["refused by this term alone", "worlds with a wrong window", "with a right window"]
    heading = f"{len(worlds)} worlds, {len(windows)} judged windows, of which the best motion of {wrong} is wrong."
    return f"{heading}\n\n{markdown_table(header, rows)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.terms", allow_abbrev=False)
    parser.description = "What each term of the risk refuses that no other one does."
    parser.add_argument("--seeds", type=int, nargs=2, default=(200_000, 200_005), metavar=("FIRST", "END"))
    parser.add_argument("--worlds", type=Path, metavar="FILE", help="worlds by another hand (default: built in)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="append one JSON line a world")
    parser.add_argument("--from-log", type=Path, nargs="+", metavar="FILE", help="the table of logs; run nothing")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    options = parser.parse_args(argv)
    if options.from_log:
        lines = [line for path in options.from_log for line in path.read_text(encoding="utf-8").splitlines()]
        worlds = [json.loads(line)["rows"] for line in lines]
    else:
        worlds = []
        for seed in range(*options.seeds):
            for world in worlds_of(options.worlds)(seed):
                worlds.append(windows_of(world))
                if options.log is not None:
                    with options.log.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"seed": seed, "rows": worlds[-1]}, default=float) + "\n")
    show(report(worlds) + "\n", options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
