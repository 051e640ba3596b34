"""Sequences that once gave a wrong map, a crash or an endless wait."""

from dataclasses import replace

import numpy as np
from make_source import GivenFrames, picked, synth

from slam_init.config import Config
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.runner import run


def test_two_photographs_of_a_rotation_only_camera_with_a_wrong_focal_length_make_no_map():
    """They look like a plane and a translation, and there is no third view to contradict it."""
    source = synth("rotation", focal_error=-0.08)
    result, _ = run(GivenFrames(source.camera, picked(source, (0, 40))), source.camera, Config())
    assert not result
    assert result.reason == "pure_rotation"


def test_a_landmark_that_loses_the_view_of_its_parallax_does_not_spoil_the_map(room):
    """The camera moves once and then is static, so that all views but the first are the same."""
    rng = np.random.default_rng(0)
    frames = list(picked(room, (0, 20)))
    for k in range(2, 30):
        noise = rng.normal(0, 3, frames[1].image.shape)
        image = np.clip(frames[1].image + noise, 0, 255).astype(np.uint8)
        frames.append(replace(frames[1], index=k, timestamp_s=k / 30, image=image))
    result, _ = run(GivenFrames(room.camera, tuple(frames)), room.camera, Config())
    assert result
    true = [replace(keyframe, timestamp_s=20 * min(keyframe.frame, 1) / 30) for keyframe in result.map.keyframes]
    errors = compare_with_groundtruth(true, room.groundtruth)
    assert errors.rotation_error_deg < 5
    assert errors.direction_error_deg < 15
