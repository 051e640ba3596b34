"""One finished comparison that several tests read."""

from __future__ import annotations

from pathlib import Path

import pytest
from comparisons import METHODS, SOURCES

from slam_init.compare.figures import Figures
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Plan


@pytest.fixture(scope="session")
def plan() -> Plan:
    """Three sources of points, two methods that work and one that raises."""
    return Plan(tuple(describe_sources(SOURCES)), METHODS)


@pytest.fixture(scope="session")
def finished(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Figures]:
    """The folder and the summary of a comparison that was not interrupted."""
    out = tmp_path_factory.mktemp("compare") / "out"
    summary, _ = compare(plan, out, command="slam-init compare")
    return out, summary
