"""``slam-init calibrate``."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from slam_init.cli import parser
from slam_init.system.process_io import emit

if TYPE_CHECKING:
    from slam_init.methods.self_calibration import SelfCalibration

_DEFAULT_OUT = "slam-init-calibration"


def add_calibrate(commands: parser.Commands) -> None:
    """Add the command."""
    description = (
        "Estimate focal length and radial distortion from the stretches of a video that fix them; write camera.yaml "
        "with standard deviations. Turn the camera while it moves. A calibration of the source is not used."
    )
    calibrate = parser.add_command(
        commands, "calibrate", _calibrate, "estimate the focal length from a video", description
    )
    parser.add_source(calibrate, default=None, camera="auto")
    helps = {
        "--start K": "skip the first K frames",
        "--max-frames N": "read at most N frames",
        "--seed N": "of random draws (default: 0)",
        "--out DIR": parser.OUT_HELP,
    }
    types = {"--start": parser.number(0), "--max-frames": parser.number(1), "--seed": parser.number(0)}
    parser.add_options(calibrate, helps, types, start=0, seed=0, out=_DEFAULT_OUT)


def _calibrate(arguments: argparse.Namespace) -> int:
    """``slam-init calibrate``."""
    from slam_init.output.folder import OutputFolder, chosen_folder

    out = chosen_folder(arguments.out, "calibrate", [arguments.source])

    from slam_init.calibration.files import camera_yaml
    from slam_init.config import Config
    from slam_init.methods.self_calibration import calibrate
    from slam_init.output.plain_json import json_text

    source = parser.opened_source(arguments, arguments.seed)
    arguments.camera = arguments.camera or "auto"
    camera = parser.chosen_camera(arguments, source, arguments.start)
    with OutputFolder(out, "calibrate") as folder:
        found = calibrate(
            source,
            camera,
            Config(seed=arguments.seed),
            start=arguments.start,
            max_frames=arguments.max_frames,
            progress=sys.stderr.isatty(),
        )
        texts = {"calibration.json": json_text(found)}
        if found.camera is not None:
            texts["camera.yaml"] = camera_yaml(found.camera)
        folder.write({name: text.encode() for name, text in texts.items()})
        folder.publish()
    emit(_text(found, str(out)))
    return parser.DONE if found.camera is not None else parser.NOT_INITIALIZED


def _text(found: SelfCalibration, out: str) -> str:
    """What the user reads."""
    from quest.display import aligned
    from slam_init.types.lens import MAX_FOCAL_SIGMA
    from slam_init.types.refusal import Verdict

    stretches = f"{len(found.stretches)} of {found.tried} stretches"
    if found.camera is None:
        why = f"none of {found.tried} stretches fixes the focal length"
        if found.focal_sigma is not None:
            why = (
                f"{stretches} fix the focal length to {found.focal_sigma:.1%}; at most {MAX_FOCAL_SIGMA:.0%} is needed"
            )
        advice = "turn the camera while it moves, before a scene with depth; a longer video has more stretches"
        # Nothing is said of the lens where there is no texture, or no motion: that comes first.
        if not found.stretches and found.reason not in (None, Verdict.UNKNOWN_FOCAL_LENGTH):
            why += f" (mostly {str(found.reason).replace('_', ' ')})"
            advice = found.advice
        return f"not calibrated: {why}\n  advice        {advice}\n"
    camera = found.camera
    k1, k2 = (*camera.distortion, 0.0, 0.0)[:2]
    second = f", k2 = {k2:.4f}" if k2 else ""
    facts = [
        ("focal length", f"{camera.fx:.1f} +- {camera.focal_sigma_px:.1f} px"),
        ("distortion", f"k1 = {k1:.4f} +- {found.k1_sigma:.4f}{second}"),
    ]
    if len(found.stretches) == 1:
        facts.append(("note", "one stretch only: nothing confirms it; a longer video has more"))
    return aligned(f"calibrated by {stretches}", [*facts, ("results", f"{out}/camera.yaml")]) + "\n"
