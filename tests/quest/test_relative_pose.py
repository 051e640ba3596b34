"""The evidence of a pose as typed fields and as a dictionary."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, box, line, plane, views

from quest import estimate_relative_pose
from quest.geometry.homography import homography_residuals

BEFORE_PARALLAX = ["matches", "samples", "inliers", "noise_rad"]
PARALLAX = ["chance_inliers", "false_alarms", "parallax_z", "parallax_p"]


@pytest.mark.parametrize(
    ("matches", "names"),
    [
        (views(box(0, count=9)), ["matches", "needed"]),
        (views(box(0), noise_rad=NOISE_RAD), [*BEFORE_PARALLAX, *PARALLAX, "on_plane", "off_plane"]),
        (views(plane(0), noise_rad=NOISE_RAD), [*BEFORE_PARALLAX, *PARALLAX, "on_plane", "off_plane"]),
        (views(box(0), t=NO_TRANSLATION, noise_rad=NOISE_RAD), [*BEFORE_PARALLAX, *PARALLAX, "rotation_inliers"]),
        (views(line(0), noise_rad=NOISE_RAD, outliers=0.3), [*BEFORE_PARALLAX, *PARALLAX, "off_line_rad"]),
    ],
    ids=["too few matches", "general", "plane", "rotation-only camera", "line"],
)
def test_the_dictionary_has_the_known_fields_in_order(matches, names):
    evidence = estimate_relative_pose(*matches).evidence
    assert list(evidence.as_dict()) == names
    assert evidence.as_dict() == {name: getattr(evidence, name) for name in names}


@pytest.mark.parametrize(("scene", "options"), [(plane, {}), (box, {"t": NO_TRANSLATION})], ids=["planar", "rotation"])
def test_the_homography_takes_rays_of_a_plane_and_of_a_rotation_to_the_other_view(request, scene, options):
    m, n = views(scene(0), noise_rad=NOISE_RAD, outliers=0.2, **options)
    pose = estimate_relative_pose(m, n)
    assert pose.kind == request.node.callspec.id
    errors = np.linalg.norm(homography_residuals(pose.H, m[pose.inliers], n[pose.inliers]), axis=1)
    assert np.median(errors) < 1.5 * NOISE_RAD
    assert estimate_relative_pose(*views(box(0), noise_rad=NOISE_RAD)).H is None


def test_a_pose_and_no_pose_are_reported_in_a_few_lines_and_as_a_table():
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 2), (1, 1, 4), (60, 3))
    pose = estimate_relative_pose(points, points + np.array([0.3, 0.1, 0.0]), threshold_rad=1e-3)
    assert repr(pose) == "<RelativePose: general pose, 60 inliers of 60 matches>"
    assert len(str(pose).splitlines()) <= 6
    assert pose._repr_html_().startswith("<table><caption>general pose")
    nothing = estimate_relative_pose(points[:4], points[:4], threshold_rad=1e-3)
    assert repr(nothing) == "<NoPose: no pose: too_few_matches>"
