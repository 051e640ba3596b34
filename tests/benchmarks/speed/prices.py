"""What the parts of a judgement announce (:class:`slam_init.work.Prices`), and what they take."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam_init.types.frame import Source


def prices_table(sources: Sequence[tuple[str, Source]], max_frames: int | None = None) -> str:
    """What the parts of a judgement announce and what they take, over some sequences.

    Shapes: ``sources`` (str, Source).
    """
    import numpy as np

    from slam_init import work
    from slam_init.config import Config
    from slam_init.initializer import Initializer
    from slam_init.output.tables import markdown_table, number

    parts: dict[str, list[tuple[float, float]]] = {}
    last: list[tuple[str, float, float]] = []

    def end() -> None:
        if last:
            name, amount, begin = last.pop()
            parts.setdefault(name, []).append((amount, 1e6 * (time.perf_counter() - begin)))

    def spend(amount: float) -> None:
        end()
        caller = sys._getframe(1).f_code
        last.append((f"{Path(caller.co_filename).stem}.{caller.co_name}", amount, time.perf_counter()))

    import_module("slam_init.decision.window_rule")  # and with it all modules that announce work
    real = work.spend
    holders = [module for module in list(sys.modules.values()) if getattr(module, "spend", None) is real]
    try:
        for module in holders:
            vars(module)["spend"] = spend
        for _, source in sources:
            assert source.camera is not None
            # One slice without an end: with as many tracks as in slices.
            initializer = Initializer(source.camera, Config(work_per_frame=1e9))
            for frame in islice(source.frames(), max_frames):
                done = initializer.process(frame)
                last.clear()
                if done:
                    break
    finally:
        for module in holders:
            vars(module)["spend"] = real
    rows = []
    for name, samples in sorted(parts.items(), key=lambda item: -sum(ms for _, ms in item[1])):
        announced, taken = np.array(samples).T
        figures = [float(np.median(announced)), float(np.median(taken)), float(np.percentile(taken, 95))]
        ratio = float(taken.sum() / announced.sum())
        rows.append([name, str(len(samples)), *(number(one, 0) for one in figures), number(ratio)])
    header = ["part", "calls", "announced (median, us)", "taken: median", "95th percentile", "taken over announced"]
    return markdown_table(header, rows)
