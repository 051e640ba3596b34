"""Features and matches of others as sources: one scene in three formats gives the same tracks, and a right map."""

import sqlite3

import make_matches
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_files import picture, write, write_image
from make_matches import CAMERA, NAMES, scene, write_database, write_hloc, write_tracks

from slam_init.calibration.files import load_camera
from slam_init.cli import main
from slam_init.config import Config
from slam_init.datasets import detect_kind, open_source
from slam_init.datasets.track_source import PairMatches, chain_matches, with_pictures
from slam_init.errors import CalibrationError, SlamInitError, SourceError
from slam_init.methods.self_calibration import calibrate
from slam_init.runner import run


def observed(source):
    """For each frame the pixels of its tracks, by the first pixel of the track: ids differ between formats."""
    frames = [source.observed(frame, CAMERA) for frame in source.frames()]
    first = {}
    for seen in frames:
        for track, pixel in zip(seen.track_ids.tolist(), seen.pixels.tolist(), strict=True):
            first.setdefault(track, (seen.frame, *np.round(pixel, 3)))
    return [
        {first[track]: pixel for track, pixel in zip(seen.track_ids.tolist(), seen.pixels, strict=True)}
        for seen in frames
    ]


def test_the_formats_give_the_same_tracks(tmp_path):
    made = scene()
    (tmp_path / "hloc").mkdir()
    (tmp_path / "old").mkdir()
    expected = observed(open_source(write_tracks(tmp_path / "tracks.npz", made)))
    files = [write_database(tmp_path / "a.db", made), write_database(tmp_path / "b.db", made, verified=False)]
    if pytest.importorskip("h5py"):
        files += [write_hloc(tmp_path / "hloc", made), write_hloc(tmp_path / "old", made, "_")]
    for file in files:
        found = observed(open_source(file))
        for a, b in zip(expected, found, strict=True):
            assert len(a) == len(b)
            np.testing.assert_allclose(
                sorted(map(tuple, a.values())), sorted(map(tuple, b.values())), atol=1e-3
            )  # single precision of the formats


def test_a_focal_length_that_is_a_guess_of_colmap_is_no_calibration(tmp_path):
    source = open_source(write_database(tmp_path / "database.db", scene(), prior=0))
    assert source.camera is None
    assert "prior_focal_length" in source.notes[0]


def test_a_map_of_given_tracks_is_right_and_the_same_each_time(tmp_path):
    source = open_source(write_tracks(tmp_path / "tracks.npz", scene()))
    results = [run(source, source.camera, Config(), continue_frames=1) for _ in range(2)]
    (result, summary), (_, again) = results
    assert result.map is not None
    assert summary.ground_truth.rotation_error_deg < 0.5
    assert summary.ground_truth.direction_error_deg < 3
    assert summary.continued.located == 1
    assert summary.provenance.input_blake2b == again.provenance.input_blake2b
    moved = write_tracks(
        tmp_path / "moved.npz", scene(), xy=make_matches.tracks_arrays(scene())["xy"] + 1e-3
    )  # less than the dots of the rendered images show
    assert run(open_source(moved), CAMERA, Config())[1].provenance.input_blake2b != again.provenance.input_blake2b


def test_the_command_writes_all_results_of_a_database_without_images(tmp_path, capsys):
    database = write_database(tmp_path / "database.db", scene())
    assert main(["run", str(database), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "recording.rrd").stat().st_size > 10_000
    assert "view2.png" in (tmp_path / "out" / "colmap" / "images.txt").read_text()
    assert "initialized after" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["database.db", "out"]  # nothing beside the database


def test_pictures_bring_times_truth_and_colours_in_their_own_order(tmp_path):
    made = scene()
    source = open_source(write_database(tmp_path / "database.db", made, prior=0))
    folder = tmp_path / "sequence"
    order = (2, 0, 3, 1)  # the times are in another order than the names
    for i, name in enumerate(NAMES):
        write_image(folder / "images" / name, picture(i, (640, 480)))
    write(folder / "rgb.txt", "".join(f"{k / 10} images/{NAMES[i]}\n" for k, i in enumerate(order)))
    write(folder / "groundtruth.txt", "".join(f"{k / 10} {i} 0 0 0 0 0 1\n" for k, i in enumerate(order)))
    seen = with_pictures(source, open_source(folder))
    assert seen.image_names == tuple(NAMES[i] for i in order)
    np.testing.assert_allclose(seen.timestamps_s, [0, 0.1, 0.2, 0.3])
    assert [seen.groundtruth.at(t).t[0] for t in seen.timestamps_s] == list(order)
    frame = next(seen.frames(1, 1))
    np.testing.assert_array_equal(frame.image, picture(0, (640, 480)))
    pixels = seen.observed(frame, CAMERA).pixels
    plain = source.observed(next(source.frames(0, 1)), CAMERA).pixels
    np.testing.assert_array_equal(np.sort(pixels, axis=0), np.sort(plain, axis=0))
    (folder / "images" / NAMES[1]).unlink()
    write(folder / "rgb.txt", f"0 images/{NAMES[0]}\n")
    with pytest.raises(SourceError, match=r"no picture of view9.png"):
        with_pictures(source, open_source(folder))


def test_pictures_for_a_source_that_has_images_are_a_usage_error(tmp_path, capsys):
    assert main(["info", "synth:room", "--images", str(tmp_path)]) == 2
    assert "--images is for a source of matches" in capsys.readouterr().err


DAMAGES = {
    "DELETE FROM images": "holds no image",
    "UPDATE images SET camera_id = 7": "camera 7, which is missing",
    "UPDATE images SET name = 'a.png'": "is there 4 times",
    "UPDATE cameras SET model = 99": "camera 1",
    "UPDATE cameras SET width = 40000, height = 40000": "million",
    "UPDATE cameras SET params = x'01'": "unexpected type",
    "UPDATE keypoints SET rows = 1000000000": "are no 1000000000x6 numbers",
    "UPDATE keypoints SET rows = 'many'": "unexpected type",
    "UPDATE keypoints SET data = zeroblob(length(data) - 1)": "numbers",
    "DELETE FROM keypoints": "names a keypoint",
    "DELETE FROM two_view_geometries; DELETE FROM matches": "holds no track",
    "UPDATE two_view_geometries SET pair_id = -pair_id": "holds no track",
    "DROP TABLE matches": "its tables are others",
    "ALTER TABLE images RENAME COLUMN name TO title": "of another version",
    "ALTER TABLE images RENAME TO old; CREATE VIEW images AS SELECT * FROM old": "its tables are others",
}


@pytest.mark.parametrize("statement", sorted(DAMAGES))
def test_a_damaged_database_is_refused_in_one_line(tmp_path, statement):
    path = write_database(tmp_path / "database.db", scene(points=60))
    with sqlite3.connect(path) as database:
        database.executescript(statement)
    database.close()
    with pytest.raises(SlamInitError, match=DAMAGES[statement]) as caught:
        open_source(path)
    assert str(path) in str(caught.value)


def test_a_database_that_is_open_elsewhere_is_refused(tmp_path):
    path = write_database(tmp_path / "database.db", scene(points=60))
    write(tmp_path / "database.db-wal", "changes")
    with pytest.raises(SourceError, match="close the program"):
        open_source(path)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"xy": None}, "has no array xy"),
        ({"xy": np.zeros((3, 2))}, "rows"),
        ({"xy": np.full((3, 2), np.nan)}, "not finite"),
        ({"xy": np.array([{}], object)}, "allow_pickle=False"),
        ({"track": np.array([0.5])}, "of integers"),
        ({"frame": np.full(1, 2**63, np.uint64)}, r"beyond 2\^63"),
        ({"size": np.array([0, 480])}, "0x480"),
        ({"size": np.array([40000, 40000])}, "million"),
        ({"names": np.array(["a", "a", "b", "c"])}, "2 times"),
        ({"names": np.array(["a"])}, "1 names"),
        ({"timestamps_s": np.array([0.0, 2.0, 1.0, 3.0])}, r"timestamps_s\[2\].*does not come after"),
        ({"K": np.zeros((3, 3))}, "K: focal"),
        ({"K": np.eye(2)}, "K has the shape"),
        ({"world_from_cam": np.zeros((4, 4, 4))}, "not a rotation"),
        ({"world_from_cam": np.zeros((2, 4, 4))}, r"expected numbers \(4, 4, 4\)"),
    ],
)
def test_an_impossible_array_of_tracks_is_named(tmp_path, changes, word):
    path = write_tracks(tmp_path / "tracks.npz", scene(points=60), **changes)
    with pytest.raises(SlamInitError, match=word) as caught:
        open_source(path)
    assert "tracks.npz" in str(caught.value)


def test_a_track_that_is_twice_in_a_frame_is_refused(tmp_path):
    arrays = make_matches.tracks_arrays(scene(points=60))
    path = write_tracks(tmp_path / "tracks.npz", scene(points=60), track=np.zeros_like(arrays["track"]))
    with pytest.raises(SourceError, match="twice"):
        open_source(path)


def with_matches_of_an_unknown_image(_, file):
    file["db-view2.png/unknown.png/matches0"] = np.zeros(3)


def with_an_image_of_another_size(feats, _):
    del feats["db/view9.png/image_size"]
    feats["db/view9.png/image_size"] = np.array([100, 100])


def test_broken_files_of_hloc_are_refused_and_a_link_is_not_followed(tmp_path):
    h5py = pytest.importorskip("h5py")
    path, features = write_hloc(tmp_path, scene(points=60)), tmp_path / "feats.h5"
    assert detect_kind(path) == "hloc"
    with pytest.raises(SourceError, match=r"no matches0|no keypoints"):
        open_source(features)
    pixels = open_source(path).table.pixels
    with h5py.File(tmp_path / "outside.h5x", "w") as file:
        file["matches0"] = np.zeros(3)
    with h5py.File(path, "a") as file:
        file["a/b"] = h5py.ExternalLink(str(tmp_path / "outside.h5x"), "/")
    assert np.array_equal(open_source(path).table.pixels, pixels)
    for damage, message in (
        (with_matches_of_an_unknown_image, "names an image"),
        (with_an_image_of_another_size, "of one camera"),
    ):
        write_hloc(tmp_path, scene(points=60))
        with h5py.File(features, "a") as feats, h5py.File(path, "a") as file:
            damage(feats, file)
        with pytest.raises(SourceError, match=message):
            open_source(path)
    features.unlink()
    with pytest.raises(SourceError, match="no features beside it"):
        open_source(path)


def test_a_source_of_tracks_without_a_camera_needs_one(tmp_path, capsys):
    path = write_tracks(tmp_path / "tracks.npz", scene(), K=None)
    with pytest.raises(SourceError, match="no calibration"):
        next(open_source(path).observations())
    write(tmp_path / "other.yaml", "width: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n")
    assert main(["info", str(path), "--camera", str(tmp_path / "other.yaml")]) == 2
    assert "640x480" in capsys.readouterr().err
    bad = write_tracks(tmp_path / "bad.npz", scene(), model=np.array("magic"))
    with pytest.raises(CalibrationError, match="magic"):
        open_source(bad)


def test_a_database_that_colmap_itself_wrote_is_read(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    made = scene(points=60)
    path = tmp_path / "database.db"
    with pycolmap.Database.open(path) as database:
        camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500.0, 500.0, 320.0, 240.0])
        camera.has_prior_focal_length = True
        camera.camera_id = database.write_camera(camera)
        ids = []
        for name, points in zip(NAMES, made.keypoints, strict=True):
            ids.append(database.write_image(pycolmap.Image(name=name, camera_id=camera.camera_id)))
            database.write_keypoints(ids[-1], (points + 0.5).astype(np.float32))
        for i, j in make_matches.pairs():
            database.write_matches(ids[i], ids[j], made.pair(i, j).astype(np.uint32))
    source = open_source(path)
    expected = open_source(write_tracks(tmp_path / "tracks.npz", made))
    assert source.camera == CAMERA
    assert len(source.table.frames) == len(expected.table.frames)
    np.testing.assert_allclose(np.sort(source.table.pixels[:, 0]), np.sort(expected.table.pixels[:, 0]), atol=1e-3)


def test_a_camera_is_calibrated_from_given_tracks(tmp_path):
    source = open_source(write_tracks(tmp_path / "tracks.npz", scene(), K=None))
    found = calibrate(source, load_camera("auto", (640, 480))).camera
    assert abs(found.focal_px - CAMERA.focal_px) < 2 * found.focal_sigma_px


# -- matches chained to tracks ---------------------------------------------------------------------


def keypoints(counts):
    """Keypoints at different places."""
    return [np.column_stack([np.arange(n, dtype=float), np.full(n, 7.0 * i)]) for i, n in enumerate(counts)]


def pair(first, second, *matched):
    return PairMatches(first, second, np.array(matched, int).reshape(-1, 2))


def tracks(table):
    """Each track as a set of (image, keypoint)."""
    found = {}
    for frame, track, xy in zip(table.frames.tolist(), table.track_ids.tolist(), table.pixels.tolist(), strict=True):
        found.setdefault(track, set()).add((frame, int(xy[0])))
    return sorted(map(sorted, found.values()))


def test_a_match_that_joins_two_points_of_one_image_is_dropped_and_the_tracks_are_kept():
    # Tracks a = (0,0)-(1,0)-(2,0) and b = (0,1)-(1,1)-(2,1); a wrong match of the far images 0 and 2 joins them.
    right = [pair(0, 1, (0, 0), (1, 1)), pair(1, 2, (0, 0), (1, 1))]
    table, notes = chain_matches(keypoints([2, 2, 2]), [pair(0, 2, (0, 1)), *right], "x")
    assert tracks(table) == [[(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 1), (2, 1)]]
    assert notes[0].startswith("1 matches")


def test_keypoints_at_one_place_are_one():
    points = keypoints([2, 2])
    points[0][1] = points[0][0]  # two orientations of a SIFT feature
    table, notes = chain_matches(points, [pair(0, 1, (0, 0), (1, 0))], "x")
    assert len(tracks(table)) == 1
    assert (len(table.frames), notes) == (2, ())


@given(
    st.lists(st.tuples(*[st.integers(0, 3), st.integers(0, 3), st.integers(0, 4), st.integers(0, 4)]), max_size=25),
    st.randoms(use_true_random=False),
)
@settings(max_examples=60)
def test_the_order_and_the_direction_of_the_pairs_change_nothing_and_no_track_is_twice_in_an_image(matches, random):
    pairs = [pair(i, j, (a, b)) for i, j, a, b in matches]
    table, notes = chain_matches(keypoints([5] * 4), pairs, "x")
    assert len(set(zip(table.frames.tolist(), table.track_ids.tolist(), strict=True))) == len(table.frames)
    assert (np.bincount(table.track_ids, minlength=1) != 1).all()  # a track is seen twice at least
    random.shuffle(pairs)
    swapped = [PairMatches(p.second, p.first, p.keypoints[:, ::-1]) for p in pairs]
    again, notes_again = chain_matches(keypoints([5] * 4), swapped, "x")
    assert tracks(table) == tracks(again)
    assert notes == notes_again
