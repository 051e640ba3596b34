"""Monocular SLAM initialization: from a video to a bundle-adjusted map, on planes too, or a reason why not.

The names below are loaded when they are first used, so that ``import slam_init`` and the command line stay quick.
Attempts and refusals are told to the logger ``slam_init`` at the levels INFO and DEBUG; the library prints nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.types.savable import Savable

if TYPE_CHECKING:
    from slam_init.calibration.files import load_camera as load_camera
    from slam_init.calibration.prior import prior_camera as prior_camera
    from slam_init.config import Config as Config
    from slam_init.config import load_config as load_config
    from slam_init.datasets.opening import open_source as open_source
    from slam_init.decision.audit import audit as audit
    from slam_init.errors import CalibrationError as CalibrationError
    from slam_init.errors import ConfigError as ConfigError
    from slam_init.errors import OutputError as OutputError
    from slam_init.errors import SlamInitError as SlamInitError
    from slam_init.errors import SourceError as SourceError
    from slam_init.exports import export as export
    from slam_init.initializer import Initializer as Initializer
    from slam_init.mapping.follower import Follower as Follower
    from slam_init.output.colmap import pycolmap_reconstruction as pycolmap_reconstruction
    from slam_init.output.results import load_graph as load_graph
    from slam_init.output.results import write_colmap as write_colmap
    from slam_init.output.results import write_results as write_results
    from slam_init.runner import run as run
    from slam_init.scale.find import find_scale as find_scale
    from slam_init.scale.metric_map import in_metres as in_metres
    from slam_init.scale.requests import parse_scale as parse_scale
    from slam_init.types.audit import Audit as Audit
    from slam_init.types.audit import AuditVerdict as AuditVerdict
    from slam_init.types.camera import Camera as Camera
    from slam_init.types.frame import Frame as Frame
    from slam_init.types.frame import Observations as Observations
    from slam_init.types.gates import Gate as Gate
    from slam_init.types.initial_map import InitialMap as InitialMap
    from slam_init.types.initial_map import Keyframe as Keyframe
    from slam_init.types.pose import Pose as Pose
    from slam_init.types.pose import Trajectory as Trajectory
    from slam_init.types.reasons import Verdict as Verdict
    from slam_init.types.result import Attempt as Attempt
    from slam_init.types.result import Result as Result
    from slam_init.types.result import Segment as Segment
    from slam_init.types.scale import Scale as Scale
    from slam_init.types.status import Status as Status

    __version__: str

#: The names of each module.
_NAMES = {
    "calibration.files": "load_camera",
    "calibration.prior": "prior_camera",
    "config": "Config load_config",
    "datasets.opening": "open_source",
    "decision.audit": "audit",
    "errors": "CalibrationError ConfigError OutputError SlamInitError SourceError",
    "exports": "export",
    "initializer": "Initializer",
    "mapping.follower": "Follower",
    "output.colmap": "pycolmap_reconstruction",
    "output.results": "load_graph write_colmap write_results",
    "runner": "run",
    "scale.find": "find_scale",
    "scale.metric_map": "in_metres",
    "scale.requests": "parse_scale",
    "types.audit": "Audit AuditVerdict",
    "types.camera": "Camera",
    "types.frame": "Frame Observations",
    "types.gates": "Gate",
    "types.initial_map": "InitialMap Keyframe",
    "types.pose": "Pose Trajectory",
    "types.reasons": "Verdict",
    "types.result": "Attempt Result Segment",
    "types.scale": "Scale",
    "types.status": "Status",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted([*_HOMES, "__version__"])

Savable.writer = staticmethod(lambda thing, folder: import_module("slam_init.output.results").save(thing, folder))


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("slam-init")
        except PackageNotFoundError:
            return "0+unknown"
    if name in _HOMES:
        return getattr(import_module(f"slam_init.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'slam_init' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
