"""Laws of the audit: a true map is sound, and maps of another motion or of a mere rotation are not."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import point_source

from quest import estimate_relative_pose
from quest.geometry.quaternion import rotation_from_vector
from slam_init import AuditVerdict, Camera, Pose, SlamInitError, Verdict, audit
from slam_init.types.history import common_tracks
from slam_init.window.motion import difference_deg


def world(scene, seed=0, **options):
    """The tracks of a simulated world, its camera, and its true poses by frame."""
    source = point_source(scene, seed, **options)
    return list(source.observations()), source.camera, dict(enumerate(source.groundtruth.world_from_cam))


def turned(poses, frame, vector_deg):
    """The same poses, one of them turned about its camera."""
    turn = Pose(rotation_from_vector(np.radians(vector_deg)), np.zeros(3))
    return poses | {frame: poses[frame] @ turn}


@pytest.fixture(scope="module")
def room():
    return world("room", baseline=0.2)


@pytest.fixture(scope="module")
def of_truth(room):
    views, camera, poses = room
    return audit(poses, views, camera)


def test_a_true_map_is_sound(of_truth):
    assert of_truth and of_truth.verdict is AuditVerdict.SOUND
    assert of_truth.better is None and of_truth.reason is None and of_truth.advice == ""
    assert str(of_truth).startswith("sound: risk 0.01 ")


def test_the_terms_add_up(of_truth):
    names = ("direction", "competing", "rotation", "moving", "floor", "map")
    terms = [getattr(of_truth, f"risk_{name}") for name in names]
    assert all(0 <= term <= 1 for term in terms)
    assert of_truth.model_risk == pytest.approx(min(1.0, sum(terms)))


def test_world_and_unit_of_a_map_change_nothing(room, of_truth):
    views, camera, poses = room
    world_from_old = Pose(rotation_from_vector(np.array([0.4, -1.1, 0.3])), np.array([3.0, -70.0, 8.0]))
    moved = {frame: world_from_old @ replace(pose, t=40 * pose.t) for frame, pose in poses.items()}
    found = audit({frame: pose.matrix() for frame, pose in moved.items()}, views, camera)
    assert found.verdict is of_truth.verdict
    assert found.risk == pytest.approx(of_truth.risk, rel=1e-3)


def test_a_camera_that_is_turned_by_20_degrees_makes_a_map_wrong(room, of_truth):
    views, camera, poses = room
    found = audit(turned(poses, of_truth.pair[1], [0.0, 20.0, 0.0]), views, camera)
    assert found.verdict is AuditVerdict.WRONG
    assert found.advice
    true = poses[found.pair[1]].inverse() @ poses[found.pair[0]]
    assert found.better is not None and max(difference_deg(found.better, true)) < 5


def test_a_further_camera_is_evaluated_as_well(room, of_truth):
    views, camera, poses = room
    further = of_truth.frames[len(of_truth.frames) // 2]
    assert further not in of_truth.pair
    found = audit(turned(poses, further, [20.0, 0.0, 0.0]), views, camera)
    assert found.verdict is AuditVerdict.WRONG


@pytest.mark.parametrize("seed", range(2))
def test_the_conjugate_motion_of_a_plane_is_not_sound(seed):
    views, camera, poses = world("wall", seed, baseline=0.2)
    first, last = views[0], views[-1]
    i, j = common_tracks(first, last)
    pose = estimate_relative_pose(first.bearings[i], last.bearings[j], threshold_rad=2 / camera.fx)
    true = poses[last.frame].inverse() @ poses[first.frame]
    proposed = [Pose(one.R, one.t) for one in (pose, *pose.alternatives)]
    conjugate = max(proposed, key=lambda one: difference_deg(one, true)[1])
    assert max(difference_deg(conjugate, true)) > 15
    found = audit({first.frame: Pose.identity(), last.frame: conjugate.inverse()}, views, camera)
    assert not found and found.advice


def test_a_map_of_a_camera_that_only_rotates_is_not_sound():
    views, camera, poses = world("rotation")
    invented = {frame: replace(pose, t=np.array([0.02 * frame, 0.0, 0.0])) for frame, pose in poses.items()}
    found = audit(invented, views, camera)
    assert not found
    assert found.reason is Verdict.PURE_ROTATION and found.better is None
    assert found.advice == Verdict.PURE_ROTATION.advice


def at_one_place(poses):
    return {frame: replace(pose, t=np.ones(3)) for frame, pose in poses.items()}


def apart(view):
    """A view that shares no track with another."""
    return replace(view, track_ids=view.track_ids + 10_000 * view.frame)


def mirrored(view):
    return replace(view, bearings=view.bearings * [1, -1, -1])


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda views, camera, poses: (at_one_place(poses), views, camera), "no baseline"),
        (lambda views, camera, poses: ({0: poses[0]}, views, camera), "two or more"),
        (lambda views, camera, poses: (poses | {3: 2 * np.eye(4)}, views, camera), "frame 3"),
        (lambda views, camera, poses: (poses | {3: np.eye(3)}, views, camera), "world_from_cam (4, 4)"),
        (lambda views, camera, poses: (poses, [apart(view) for view in views], camera), "share"),
        (lambda views, camera, poses: (poses, [], camera), "two or more"),
        (lambda views, camera, poses: (poses, [mirrored(view) for view in views], camera), "OpenGL"),
        (lambda views, camera, poses: (poses, views, camera.K), "Camera"),
        (lambda views, camera, poses: (list(poses.values()), views, camera), "as a dict by frame"),
        (lambda views, camera, poses: (poses, [views[0].pixels], camera), "no Observations"),
        (lambda views, camera, poses: (poses, None, camera), "slam_init.Observations"),
        (lambda views, camera, poses: ({"3": poses[3]}, views, camera), "an integer"),
        (lambda views, camera, poses: ({3: "pose"}, views, camera), "type str: give world_from_cam"),
        (lambda views, camera, poses: (poses, views, camera, "config"), "slam_init.Config"),
    ],
)
def test_what_is_no_map_is_reported_in_one_line(broken, message, room):
    views, camera, poses = room
    assert isinstance(camera, Camera)
    with pytest.raises(SlamInitError) as error:
        audit(*broken(views, camera, poses))
    assert message in str(error.value) and "\n" not in str(error.value)
