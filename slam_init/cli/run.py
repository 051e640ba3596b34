"""``slam-init run``."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.cli.parser import (
    DONE,
    NOT_INITIALIZED,
    OUT_HELP,
    Commands,
    UsageError,
    add_command,
    add_list_methods,
    number,
    refuse_changed,
)
from slam_init.cli.source_options import BY_IMU, SENSORS, add_source, chosen_camera, opened_source, with_gravity
from slam_init.system.process_io import complain, emit
from slam_init.system.regular_file import user_path

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from pathlib import Path

    from slam_init.config import Config
    from slam_init.output.summary import Summary
    from slam_init.types.frame import Source
    from slam_init.types.result import Result

_DEFAULT_SOURCE = "synth:room"
_DEFAULT_OUT = "slam-init-out"


def add_run(commands: Commands) -> None:
    """Add the command."""
    description = "Read frames until a map is found; write it, and a recording of how, to a folder."
    run = add_command(commands, "run", _run, "initialize from a sequence", description)
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
    add_list_methods(decision)
    decision.add_argument("--seed", type=number(0), metavar="N", help="of draws and synthetic worlds (default: 0)")
    decision.add_argument("--config", metavar="FILE", help="options in TOML, as in DIR/config.toml")
    decision.add_argument(
        "--matcher",
        metavar="NAME",
        help="match images in the place of following points by flow: sift, orb, lightglue, hloc:FEATURES,MATCHER, or "
        "your own as module:attribute or file.py:attribute",
    )
    decision.add_argument("--refine-focal", action="store_true", help="adjust the focal length with the map")
    decision.add_argument(
        "--imu",
        metavar="FILE",
        nargs="?",
        const=True,
        help="use the gyroscope of the source (EuRoC, ROS bags): --imu behind SOURCE; or that of a file with "
        "t,gx,gy,gz,ax,ay,az and its T_cam_imu in a YAML file of the same name: --imu=FILE.csv",
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
        help="let the map grow by the next N frames before it is exported: keyframes, landmarks, better depths",
    )
    after.add_argument(
        "--continue",
        type=number(0),
        metavar="N",
        dest="continue_frames",
        help="then locate the next N frames in the map; with --restart: read N frames after the first map",
    )
    after.add_argument(
        "--restart",
        action="store_true",
        help="follow the frames after the map, restart where it is lost: a map a segment, frame numbers of SOURCE",
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
        "--live",
        metavar="URL",
        nargs="?",
        const="spawn",
        help="show the run in a Rerun viewer while it goes on: --live behind SOURCE starts one, "
        "--live=rerun+http://HOST:9876/proxy uses one that runs",
    )
    results = run.add_argument_group("results")
    results.add_argument("--out", metavar="DIR", default=_DEFAULT_OUT, help=OUT_HELP)
    results.add_argument("--no-overview", action="store_true", help="do not draw DIR/overview.png")
    results.add_argument("--json", action="store_true", help="print the summary as JSON and nothing else")
    results.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")


def _run(arguments: argparse.Namespace) -> int:
    """``slam-init run``."""
    from slam_init.output.folder import chosen_folder
    from slam_init.scale.requests import parse_scale

    arguments.export = arguments.export.split(",") if arguments.export is not None else ()
    arguments.scale = None if arguments.scale is None else parse_scale(arguments.scale)
    arguments.config = None if arguments.config is None else user_path(arguments.config)
    read = (arguments.images, arguments.camera, arguments.mask, arguments.imu, arguments.config, arguments.gravity)
    inputs = [arguments.source, *(file for file in read if file not in (None, True, BY_IMU))]
    out = chosen_folder(arguments.out, "run", inputs)

    from slam_init.datasets.live import is_live, without_password

    if not arguments.quiet and sys.stderr.isatty():  # the libraries take seconds to load, before there is a bar
        complain(f"reading {without_password(arguments.source)}")
    from slam_init.output.plain_json import json_text
    from slam_init.output.report import report_text
    from slam_init.output.result_folder import earlier_result

    config, live = _config(arguments), is_live(arguments.source)
    _check_method(arguments, config.method)
    if not live and arguments.no_drop:
        raise UsageError("--no-drop is for live sources: leave it out")
    replaced = earlier_result(out)
    arguments.sensor = None
    if isinstance(arguments.imu, str):
        from slam_init.datasets.inertial import read_inertial_file

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
        emit(json_text(summary))
    elif not arguments.quiet:
        emit(report_text(result, summary, out, replaced))
    return DONE if summary.reason is None else NOT_INITIALIZED


def _config(arguments: argparse.Namespace) -> Config:
    """The configuration of the file, with the values that the command line gives."""
    from slam_init.config import load_config

    overrides = {
        "method": arguments.method,
        "seed": arguments.seed,
        "refine_frames": arguments.refine_frames,
        "acceptance.max_depth_sigma": arguments.max_depth_sigma,
        "acceptance.min_parallax_deg": arguments.min_parallax,
        "map.refine_focal": arguments.refine_focal or None,
        "tracking.matcher": arguments.matcher,
    }
    return load_config(arguments.config, overrides)


def _check_method(arguments: argparse.Namespace, method: str) -> None:
    """Refuse an unknown method, and options that would have no effect with it."""
    from slam_init.methods.external_command import is_external
    from slam_init.methods.registry import method_info

    external = is_external(method)
    has_window = not method_info(method).home and not external
    if arguments.refine_frames and not has_window:
        raise UsageError(f"--refine goes on with the window, which {method} has not: use --continue")
    if external and arguments.continue_frames:
        raise UsageError("--continue needs landmarks, which an external program does not give: leave --continue out")
    if external and arguments.matcher is not None:
        raise UsageError("--matcher gives tracks, which an external program does not take: leave --matcher out")
    if arguments.gravity is not None and not has_window:
        raise UsageError(f"--gravity is a measurement of the window, which {method} has not: leave it out")


def _run_live(arguments: argparse.Namespace, config: Config, out: Path) -> tuple[Result, Summary]:
    """Run on a stream. An interrupt ends it as if its data had ended, and the next one ends the program."""
    from slam_init.datasets.live import open_live
    from slam_init.initializer import load_all
    from slam_init.system.process_io import first_interrupt_calls

    stored = {"every": 1, "fps": None, "mask": None, "gravity": None, "images": None}
    refuse_changed(arguments, stored, "a live source is not read from files, and takes no")
    source = open_live(arguments.source, keep_all=arguments.no_drop)
    # Both before the stream is opened, so that no frame waits for them.
    import_module("slam_init.recording.rerun_recorder")
    load_all()
    with source:
        return _run_on(source, arguments, config, out, first_interrupt_calls(source.stop))


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
    if arguments.imu is True and gyroscope_of(source) is None:
        raise UsageError(f"--imu: {source.name} has no gyroscope ({SENSORS}): leave --imu out, or give --imu=FILE.csv")
    if isinstance(arguments.scale, MeasuredMotion) and (sensor.record if sensor else inertial_of(source)) is None:
        if sensor is not None:
            raise UsageError(f"--scale imu: {arguments.imu} has no accelerations: its columns are t,gx,gy,gz,ax,ay,az")
        raise UsageError(f"--scale imu: {source.name} has no accelerations ({SENSORS}): give --imu=FILE.csv")
    if isinstance(arguments.scale, TrueTrajectory) and source.groundtruth is None:
        raise UsageError(f"--scale groundtruth: {source.name} has no true trajectory: leave --scale out")

    from slam_init.datasets.track_source import TrackProvider

    if isinstance(source, TrackProvider) and arguments.matcher is not None:
        raise UsageError(f"--matcher matches images, and {source.name} has tracks of its own: leave it out")

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
            imu=sensor or bool(arguments.imu),
            export=arguments.export,
        )
