"""Old places of modules: they still import, with a :class:`DeprecationWarning`, for one release."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

__all__ = ["MOVED_MODULES", "install"]

#: Old module -> new modules, whose names it had; dropped in version 0.3.
MOVED_MODULES: dict[str, str] = {
    "slam_init.benchmarks.tables": "slam_init.output.tables",
    "slam_init.bootstrap": "slam_init.decision.screening",
    "slam_init.bundle_graph": "slam_init.bundle.graph",
    "slam_init.bundle_noise": "slam_init.bundle.noise",
    "slam_init.bundle_problem": "slam_init.bundle.problem",
    "slam_init.calibration_check": "slam_init.decision.rotation_only",
    "slam_init.calibration_formats": "slam_init.calibration.formats",
    "slam_init.camera": "slam_init.types.camera",
    "slam_init.colmap": "slam_init.output.colmap",
    "slam_init.compare.child": "slam_init.compare.worker",
    "slam_init.compare.kept": "slam_init.compare.map_snapshot",
    "slam_init.compare.worst": "slam_init.compare.failure_gallery",
    "slam_init.datasets.own": "slam_init.datasets.user",
    "slam_init.export": "slam_init.output.results slam_init.output.summary",
    "slam_init.focal_adjustment": "slam_init.bundle.focal",
    "slam_init.handover": "slam_init.attempt_log slam_init.decision.refusal slam_init.mapping.map_building",
    "slam_init.info": "slam_init.datasets.describe",
    "slam_init.judging": "slam_init.decision.two_views",
    "slam_init.keyframes": "slam_init.frontend.keyframes",
    "slam_init.matching": "slam_init.frontend.sift",
    "slam_init.metrics": "slam_init.evaluation.metrics",
    "slam_init.online": "slam_init.status slam_init.types.gates",
    "slam_init.pipeline": "slam_init.initializer slam_init.runner",
    "slam_init.reasons": "slam_init.types.reasons slam_init.types.gates",
    "slam_init.recording_images": "slam_init.recording.images",
    "slam_init.recording_layout": "slam_init.recording.layout",
    "slam_init.recording_methods": "slam_init.compare.methods_recorder",
    "slam_init.recording_paths": "slam_init.recording.paths",
    "slam_init.recording_text": "slam_init.recording.text",
    "slam_init.report": "slam_init.output.report",
    "slam_init.streams": "slam_init.process_io",
    "slam_init.timing": "slam_init.types.stopwatch",
    "slam_init.tracks": "slam_init.frontend.tracks",
    "slam_init.triangulation": "slam_init.mapping.triangulation",
}


class _OldModules:
    """Finds the old modules; their loader is imported with the first one, so that ``import slam_init`` stays quick."""

    @staticmethod
    def find_spec(fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname not in MOVED_MODULES:
            return None
        from quest.moved import MovedModules

        return MovedModules(MOVED_MODULES).find_spec(fullname, path, target)


def install() -> None:
    """Let the old names import from now on."""
    sys.meta_path.append(_OldModules)
