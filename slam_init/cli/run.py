"""``slam-init run``."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from slam_init.cli.parser import DONE, NOT_INITIALIZED, Commands, ListMethods, UsageError, number
from slam_init.cli.source_options import (
    SENSORS,
    add_source,
    chosen_camera,
    opened_source,
    with_gravity,
)
from slam_init.system.process_io import tell
from slam_init.system.regular_file import user_path

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from pathlib import Path

    from _typeshed import DataclassInstance

    from slam_init.config import Config
    from slam_init.output.summary import Summary
    from slam_init.types.frame import Source
    from slam_init.types.result import Result

_Section = TypeVar("_Section", bound="DataclassInstance")
_DEFAULT_SOURCE = "synth:room"
_DEFAULT_OUT = "slam-init-out"


def add_run(commands: Commands) -> None:
    """Add the command."""
    run = commands.add_parser("run", help="initialize from a sequence", allow_abbrev=False)
    run.description = "Read frames until a map is found; write it, and a recording of how, to a folder."
    run.set_defaults(command=_run)
    add_source(run, default=_DEFAULT_SOURCE)
    frames = run.add_argument_group("first and last frame")
    frames.add_argument("--start", type=number(0), default=0, metavar="K", help="skip the first K frames")
    frames.add_argument("--max-frames", type=number(1), metavar="N", help="give up after N frames")
    decision = run.add_argument_group("how it decides")
    decision.add_argument(
        "--method",
        metavar="NAME",
        help="way to initialize: quest (default), orb-slam3, ... (--list-methods); or an external program, as "
        "'command:PROGRAM {images} {times} {camera} {out}'",
    )
    decision.add_argument("--list-methods", action=ListMethods, nargs=0, help="list the methods, one a line, and exit")
    decision.add_argument(
        "--seed", type=number(0), metavar="N", help="of random draws and synthetic worlds (default: 0)"
    )
    decision.add_argument("--config", metavar="FILE", help="options in TOML, as in DIR/config.toml")
    decision.add_argument(
        "--matcher",
        metavar="NAME",
        help="match images in the place of following points by flow: sift, orb, lightglue, hloc:FEATURES,MATCHER, or "
        "your own as module:attribute or file.py:attribute",
    )
    decision.add_argument("--refine-focal", action="store_true", help="adjust the focal length with the map")
    run.bare_values["--imu"] = ""
    decision.add_argument(
        "--imu",
        metavar="FILE",
        help="use the gyroscope of the source (EuRoC, ROS bags): --imu; or that of a file with t,gx,gy,gz,ax,ay,az and "
        "its T_cam_imu in a YAML file of the same name: --imu=FILE.csv",
    )
    decision.add_argument(
        "--gravity",
        metavar="FILE",
        help="direction of gravity in the frames: a table of TIME x y z or NAME x y z; or imu: by the accelerations of "
        "the source or of --imu=FILE, where they rest",
    )
    decision.add_argument(
        "--max-depth-sigma",
        type=float,
        metavar="S",
        help="wait until three quarters of the landmarks have depths known to this share of themselves, 0.002 to 0.2 "
        "(default: 0.2)",
    )
    decision.add_argument(
        "--min-parallax",
        type=float,
        metavar="DEG",
        help="wait until the landmarks have this median parallax (default: no bound)",
    )
    after = run.add_argument_group("after the map")
    after.add_argument(
        "--refine",
        type=number(0),
        metavar="N",
        dest="refine_frames",
        help="let the map grow by the next N frames before it is handed over: keyframes, landmarks, better depths",
    )
    after.add_argument(
        "--continue",
        type=number(0),
        metavar="N",
        dest="continue_frames",
        help="then resect the next N frames with the map; with --restart: frames to read after the first map",
    )
    after.add_argument(
        "--restart",
        action="store_true",
        help="follow the frames after the map and start anew where it is lost: one map a segment",
    )
    after.add_argument(
        "--scale",
        metavar="HOW",
        help="metres by a known length: marker:tag36h11:0.14, board:9x6:0.025, height:1.65[,nadir], "
        "distance:0.25[,I,J] or groundtruth; a length may have a deviation, as in 1.65+-0.02; or imu: accelerations of "
        "the source or of --imu=FILE",
    )
    after.add_argument(
        "--export",
        metavar="FORMATS",
        help="also write the map for other tools: scene (images, COLMAP model and transforms.json for COLMAP, "
        "nerfstudio, 3DGS)",
    )
    live = run.add_argument_group("live sources, and a viewer")
    live.add_argument("--no-drop", action="store_true", help="of a live source: let the sender wait, drop no frame")
    live.add_argument(
        "--reconnect", type=number(0), metavar="N", help="of a live source: attempts to connect again (default: 3)"
    )
    run.bare_values["--live"] = "spawn"
    live.add_argument(
        "--live",
        metavar="URL",
        help="show the run in a Rerun viewer while it goes on: --live starts one, --live=rerun+http://HOST:9876/proxy "
        "uses one that runs",
    )
    results = run.add_argument_group("results")
    results.add_argument(
        "--out",
        metavar="DIR",
        default=_DEFAULT_OUT,
        help="results: a new or empty folder, or one of an earlier run (default: %(default)s)",
    )
    results.add_argument("--no-overview", action="store_true", help="do not draw DIR/overview.png")
    results.add_argument("--json", action="store_true", help="print the summary as JSON and nothing else")
    results.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")


def _run(arguments: argparse.Namespace) -> int:
    """``slam-init run``."""
    config_path = user_path(arguments.config) if arguments.config is not None else None
    from slam_init.output.folder import chosen_folder
    from slam_init.output.names import RUN_FILES
    from slam_init.scale.requests import parse_scale

    arguments.export = arguments.export.split(",") if arguments.export is not None else ()
    if arguments.scale is not None:
        arguments.scale = parse_scale(arguments.scale)

    named = (arguments.images, arguments.camera, arguments.mask, arguments.imu or None, config_path)
    table = None if arguments.gravity == "imu" else arguments.gravity
    inputs = [arguments.source, *(file for file in (*named, table) if file is not None)]
    out = chosen_folder(arguments.out, "run", RUN_FILES, inputs)

    from slam_init.config import load_config
    from slam_init.datasets.live import is_live
    from slam_init.methods.external_command import is_external
    from slam_init.methods.registry import method_info

    overrides = {"method": arguments.method, "seed": arguments.seed, "refine_frames": arguments.refine_frames}
    config = load_config(config_path, overrides)
    acceptance = {"max_depth_sigma": arguments.max_depth_sigma, "min_parallax_deg": arguments.min_parallax}
    config = replace(
        config,
        acceptance=_changed(config.acceptance, acceptance),
        map=_changed(config.map, {"refine_focal": arguments.refine_focal or None}),
        tracking=_changed(config.tracking, {"matcher": arguments.matcher}),
    )
    method, external, live = config.method, is_external(config.method), is_live(arguments.source)
    has_window = not method_info(method).home and not external
    if arguments.refine_frames and not has_window:
        raise UsageError(f"--refine goes on with the window, which {method} has not: use --continue")
    if external and arguments.continue_frames:
        raise UsageError("--continue needs landmarks, which an external program does not give: leave --continue out")
    if external and arguments.matcher is not None:
        raise UsageError("--matcher gives tracks, which an external program does not take: leave --matcher out")
    if arguments.gravity is not None and not has_window:
        raise UsageError(f"--gravity is a measurement of the window, which {method} has not: leave it out")
    if not live and (arguments.no_drop or arguments.reconnect is not None):
        raise UsageError("--no-drop and --reconnect are for live sources: leave them out")
    arguments.sensor = None
    if arguments.imu:
        from slam_init.datasets.inertial_file import read_inertial_file

        arguments.sensor = read_inertial_file(arguments.imu)
    if arguments.live is not None:
        from slam_init.recording.viewer import viewer_url

        arguments.live = viewer_url(arguments.live)
    if live:
        result, summary = _run_live(arguments, config, out)
    else:
        source = with_gravity(arguments, opened_source(arguments, config.seed))
        result, summary = _run_on(source, arguments, config, out)
    if arguments.json:
        from slam_init.output.summary import summary_text

        tell(summary_text(summary))
    elif not arguments.quiet:
        from slam_init.output.report import report_text

        tell(report_text(result, summary, out))
    return DONE if summary.reason is None else NOT_INITIALIZED


def _changed(section: _Section, values: dict[str, Any]) -> _Section:
    """A section of the configuration with the values that the command line gives."""
    return replace(section, **{name: value for name, value in values.items() if value is not None})


def _run_live(arguments: argparse.Namespace, config: Config, out: Path) -> tuple[Result, Summary]:
    """Run on a stream. An interrupt ends it as if its data had ended, and the next one ends the program."""
    from slam_init.datasets.live import open_live
    from slam_init.initializer import load_all
    from slam_init.recording.rerun_recorder import load_rerun
    from slam_init.system.process_io import FirstInterruptCalls

    if arguments.every != 1 or arguments.fps is not None or arguments.mask is not None:
        raise UsageError("--every, --fps and --mask are for sources that are read from files")
    if arguments.gravity is not None:
        raise UsageError("--gravity is for sources that are read from files: leave it out")
    if arguments.images is not None:
        raise UsageError("--images is for a source of matches, and a live source has images: leave it out")
    reconnects = {} if arguments.reconnect is None else {"reconnects": arguments.reconnect}
    source = open_live(arguments.source, keep_all=arguments.no_drop, **reconnects)
    load_rerun()  # before the stream is opened, so that no frame waits for it
    load_all()
    with source:
        return _run_on(source, arguments, config, out, FirstInterruptCalls(source.stop))


def _run_on(
    source: Source,
    arguments: argparse.Namespace,
    config: Config,
    out: Path,
    interrupts: AbstractContextManager[object] | None = None,
) -> tuple[Result, Summary]:
    camera = chosen_camera(arguments, source, arguments.start)
    from slam_init.datasets.gyroscope import gyroscope_of
    from slam_init.datasets.inertial import inertial_of
    from slam_init.scale.requests import MeasuredMotion, TrueTrajectory

    sensor = arguments.sensor
    if arguments.imu == "" and gyroscope_of(source) is None:
        raise UsageError(f"--imu: {source.name} has no gyroscope ({SENSORS}): leave --imu out, or give --imu=FILE.csv")
    if isinstance(arguments.scale, MeasuredMotion) and (sensor.record if sensor else inertial_of(source)) is None:
        if sensor is not None:
            raise UsageError(f"--scale imu: {arguments.imu} has no accelerations: its columns are t,gx,gy,gz,ax,ay,az")
        raise UsageError(f"--scale imu: {source.name} has no accelerations ({SENSORS}): give --imu=FILE.csv")
    if isinstance(arguments.scale, TrueTrajectory) and source.groundtruth is None:
        raise UsageError(f"--scale groundtruth: {source.name} has no true trajectory: leave --scale out")

    from slam_init.datasets.track_source import KnowsTracks

    if isinstance(source, KnowsTracks) and arguments.matcher is not None:
        raise UsageError(f"--matcher matches images, and {source.name} has tracks of its own: leave it out")

    from slam_init.cli.loading import load_libraries

    load_libraries(pictures=not arguments.no_overview)
    from slam_init.runner import run

    with interrupts or nullcontext():
        return run(
            source,
            camera,
            config,
            out=out,
            start=arguments.start,
            max_frames=arguments.max_frames,
            continue_frames=arguments.continue_frames,
            progress=not arguments.quiet and sys.stderr.isatty(),
            overview=not arguments.no_overview,
            viewer=arguments.live,
            scale=arguments.scale,
            restart=arguments.restart,
            imu=sensor or arguments.imu is not None,
            export=arguments.export,
        )
