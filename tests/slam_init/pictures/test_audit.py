"""The picture of an audit: each verdict is drawn, with and without an image, and equal audits are equal bytes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from make_window import point_source

from slam_init import AuditVerdict, Verdict, audit
from slam_init.pictures.audit import audit_png


@pytest.fixture(scope="module")
def found():
    source = point_source("room", 0, baseline=0.2)
    poses = dict(enumerate(source.groundtruth.world_from_cam))
    return audit({frame: poses[frame] for frame in (0, 5)}, list(source.observations()), source.camera)


def pixels(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def test_equal_audits_are_equal_bytes_and_each_verdict_has_a_picture_of_its_own(found):
    wrong = replace(found, verdict=AuditVerdict.WRONG, risk=0.9, risk_map=0.9, reason=Verdict.LOW_PARALLAX)
    first, again, other = (audit_png(one) for one in (found, found, wrong))
    assert first == again != other
    assert pixels(first).shape == pixels(other).shape == (960, 1600, 3)


def test_the_image_lies_below_the_matches(found):
    width, height = found.matches.size
    images = [None, np.zeros((height, width), np.uint8), np.full((height, width, 3), (255, 0, 0), np.uint8)]
    assert len({audit_png(found, image) for image in images}) == len(images)


def test_a_map_whose_points_are_all_behind_its_cameras_is_drawn(found):
    nowhere = replace(found.matches, points=np.full_like(found.matches.points, np.nan))
    assert pixels(audit_png(replace(found, matches=nowhere))).shape == (960, 1600, 3)


def test_the_best_motion_explains_the_matches_of_a_true_map_as_the_map_does(found):
    matches = found.matches
    assert np.median(matches.map_px) == pytest.approx(np.median(matches.best_px), rel=0.3)
    assert np.linalg.norm(matches.map_centres[1]) == pytest.approx(1)
    assert np.linalg.norm(matches.best_centres[1]) == pytest.approx(1)
