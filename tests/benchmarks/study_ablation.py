"""Contribution of each part of the method: the same worlds, with one part changed at a time.

The worlds are those of :mod:`tests.benchmarks.study_parts` as slow video: 30 views for the same baseline, so that
the method can choose between reference frames. Two groups are added. ``bodies`` is a room and a wall with 30 % of the
tracks on moving bodies. ``focal`` is a rotation-only camera whose stated focal length is 5 % too long; every map is
false there.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.sources import drawn_sources
from slam_init.compare.statistics import mcnemar_exact, wilson
from slam_init.compare.trials import Settings
from slam_init.config import AcceptanceConfig, Config, KeyframeConfig
from slam_init.output.tables import markdown_table, number
from tests.benchmarks.study_parts import GENERAL, PLANAR, Cell, sources_of
from tests.benchmarks.study_tables import Rows, counts_text, frames_to_correct, interval_text, read_rows

_VIEWS = 30


@dataclass(frozen=True)
class Variant:
    """The method with one part changed."""

    #: What is changed.
    name: str
    method: str = "quest"
    config: Config = field(default_factory=Config)


VARIANTS: tuple[Variant, ...] = (
    Variant("quest"),
    Variant("no third view", "quest-two-view"),
    Variant("one reference frame", config=Config(keyframes=KeyframeConfig(window=1))),
    Variant("risk up to 0.05", config=Config(acceptance=AcceptanceConfig(max_risk=0.05))),
    Variant("risk up to 0.001", config=Config(acceptance=AcceptanceConfig(max_risk=0.001))),
)


def ablation_cells(trials: int, seed: int) -> list[Cell]:
    """Return the worlds, which are the same for every variant."""

    def worlds(scenes: Sequence[str], **fixed: float) -> tuple[str, ...]:
        fixed = {"focal_error": 0.0, "views": _VIEWS, **fixed}
        return tuple(text for scene in scenes for text in drawn_sources(scene, trials, seed, **fixed))

    return [
        Cell("general", worlds(GENERAL)),
        Cell("planar", worlds(PLANAR)),
        Cell("bodies", worlds(("room", "wall"), moving=0.3)),
        Cell("focal", worlds(("rotation",), focal_error=0.05)),
    ]


def run_ablation(out: str | os.PathLike[str], trials: int, seed: int, jobs: int, *, progress: bool) -> str:
    """Run every variant on the same worlds and compare them.

    * Returns: The table in markdown. It holds correct / false / none by group; the share of correct maps and the frames
      to the first correct map (restricted mean) over all worlds with a translation; the share of false maps over all
      worlds; the number of worlds that only the whole method, and only the variant, solves, with the p-value of
      McNemar's exact test.
    """
    cells = ablation_cells(trials, seed)
    sources = sources_of(cells)
    found: dict[str, Rows] = {}
    for variant in VARIANTS:
        folder = Path(out) / variant.name.replace(" ", "-")
        settings = Settings(seed=seed, config=variant.config)
        plan = Plan(sources, (variant.method,), every=_VIEWS, settings=settings)  # one start per world
        compare(plan, folder, jobs=jobs, progress=progress)
        found[variant.name] = read_rows(folder)
    return _table(cells, found)


def _table(cells: Sequence[Cell], found: dict[str, Rows]) -> str:
    header = ["changed", *(cell.name for cell in cells), "correct %", "false %", "frames to correct"]
    header += ["only quest : only variant", "p"]
    every = [text for cell in cells for text in cell.sources]
    moving = [text for cell in cells if cell.name != "focal" for text in cell.sources]
    whole = _correct(found[VARIANTS[0].name], VARIANTS[0].method, moving)
    lines = []
    for variant in VARIANTS:
        rows = found[variant.name]
        correct = _correct(rows, variant.method, moving)
        false = sum(rows[text, variant.method].outcome == "false" for text in every)
        lost, won = (
            sum(a and not b for a, b in zip(*pair, strict=True)) for pair in ((whole, correct), (correct, whole))
        )
        same = variant is VARIANTS[0]
        lines.append(
            [
                "nothing" if same else variant.name,
                *(counts_text([rows[text, variant.method] for text in cell.sources]) for cell in cells),
                interval_text(wilson(sum(correct), len(correct)), 100.0, 1),
                interval_text(wilson(false, len(every)), 100.0, 1),
                number(float(np.mean(frames_to_correct([rows[text, variant.method] for text in moving]))), 2),
                "-" if same else f"{lost} : {won}",
                "-" if same else f"{mcnemar_exact(lost, won):.2g}",
            ]
        )
    return markdown_table(header, lines)


def _correct(rows: Rows, method: str, sources: Sequence[str]) -> list[bool]:
    return [rows[text, method].outcome == "correct" for text in sources]
