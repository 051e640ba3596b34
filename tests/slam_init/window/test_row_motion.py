"""Law of the row motion: at the true state, turning and translation together undo a rolling shutter."""

import numpy as np
from make_window import point_source

from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.types.history import History
from slam_init.types.lens import SAME_LENS
from slam_init.window.motion import with_translation
from slam_init.window.state import WindowState
from slam_init.window.tracks import gather_tracks


def window(scene, seed, **options):
    """Tracks of five frames, reference and current first, the true state, and the pixels of a global shutter."""
    source = point_source(scene, seed, views=12, fps=30.0, turning_deg_s=60.0, noise_px=0.0, outliers=0.0, **options)
    sequence, camera = source.sequence, source.camera
    history, shutter = History(camera, 20), RollingShutter(camera)
    for observed in source.observations():
        history.add(observed)
        shutter.correct_newest(history, observed.frame)
    frames = [3, 7, 4, 5, 6]
    tracks = gather_tracks(camera, [history[frame] for frame in frames], 0.5)
    cam_from_world = np.linalg.inv(sequence.poses[frames]) @ sequence.poses[frames[0]]
    R, t = cam_from_world[:, :3, :3].copy(), cam_from_world[:, :3, 3].copy()
    first = sequence.poses[frames[0]]
    points = (sequence.points[tracks.track_ids] - first[:3, 3]) @ first[:3, :3]
    anchor = np.maximum(tracks.anchor, 0)
    in_anchor = np.einsum("tij,tj->ti", R[anchor], points) + t[anchor]
    distance = np.linalg.norm(in_anchor, axis=1)
    nothing, nowhere = np.zeros((len(R), 12)), np.zeros(len(points), bool)
    state = WindowState(R, t, in_anchor / distance[:, None], 1 / distance, SAME_LENS, nothing, None, nowhere)
    middle = np.array([camera.project(points @ R[k].T + t[k]) for k in range(len(R))])
    return tracks, state, middle


def error_px(tracks, readout_s, middle):
    left = tracks.pixels - readout_s * tracks.sweep_px_s - middle
    return float(np.sqrt(np.mean(left[tracks.seen] ** 2)))


def test_turning_and_translation_undo_a_rolling_shutter():
    tracks, state, middle = window("handheld", 1, readout_ms=30.0, speed=0.4)
    raw, turned = error_px(tracks, 0.0, middle), error_px(tracks, 0.03, middle)
    both = error_px(with_translation(tracks, state), 0.03, middle)
    assert raw > 2
    assert turned < 0.4 * raw
    assert both < 0.7 * turned
    assert both < 0.1 * raw
