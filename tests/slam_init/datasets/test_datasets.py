"""Readers: known layouts give frames, times, cameras and poses; broken ones one line that names the file."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from paths import DATA

from slam_init.datasets import detect_kind, open_source
from slam_init.datasets.image_files import read_image
from slam_init.errors import SourceError
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

YAW_90 = Pose.from_quaternion(np.array([1.0, 0, 0, 1]), np.array([1.0, 2, 3]))


def picture(i=0, size=(64, 48), channels=3, dtype=np.uint8):
    rng = np.random.default_rng(i)
    shape = (size[1], size[0], channels) if channels > 1 else (size[1], size[0])
    return rng.integers(0, np.iinfo(dtype).max, shape, dtype=dtype)


def write_image(path, image=None):
    path.parent.mkdir(parents=True, exist_ok=True)
    encoded, data = cv2.imencode(path.suffix, picture() if image is None else image)
    assert encoded
    path.write_bytes(data.tobytes())


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())


CAMERA_YAML = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"


@pytest.fixture
def tum(tmp_path):
    folder = tmp_path / "a séquence with spaces"
    for i in range(3):
        write_image(folder / "images" / f"{i}.png", picture(i))
    write(folder / "rgb.txt", "# timestamp filename\n" + "".join(f"{i / 10} images/{i}.png\n" for i in range(3)))
    write(folder / "groundtruth.txt", "".join(f"{i / 10 + 0.005} {i} 0 0 0 0 0 1\n" for i in range(3)))
    write(folder / "camera.yaml", CAMERA_YAML)
    return folder


def test_tum_folder(tum):
    source = open_source(str(tum))
    assert (source.kind, source.name, len(source)) == ("tum", tum.name, 3)
    assert source.camera == Camera("pinhole", 64, 48, 60, 60, 31.5, 23.5)
    frames = list(source.frames(1, 5))
    assert [(f.index, f.timestamp_s, f.name) for f in frames] == [(1, 0.1, "1.png"), (2, 0.2, "2.png")]
    np.testing.assert_array_equal(frames[0].image, picture(1))
    assert source.groundtruth.at(0.1).t.tolist() == [1, 0, 0]
    assert source.groundtruth.at(0.15) is None


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff0 images/0.png\n1 images/1.png\n2 images/2.png",
        "0 images/0.png\r\n1 images/1.png  \r\n\r\n# end\r\n2\timages/2.png\r\n",
    ],
)
def test_text_files_may_have_bom_crlf_blanks_and_comments(tum, text):
    write(tum / "rgb.txt", text)
    assert [frame.name for frame in open_source(str(tum)).frames()] == ["0.png", "1.png", "2.png"]


def test_file_names_in_rgb_txt_may_hold_spaces(tum):
    write_image(tum / "images" / "a b.png")
    write(tum / "rgb.txt", "0 images/a b.png\n")
    assert next(open_source(str(tum)).frames()).name == "a b.png"


@pytest.mark.parametrize(
    ("name", "text", "place"),
    [
        ("rgb.txt", "0 images/0.png\nx images/1.png\n", "rgb.txt:2"),
        ("rgb.txt", "0 images/0.png\n1\n", "rgb.txt:2"),
        ("rgb.txt", "1 images/0.png\n1 images/1.png\n", "rgb.txt:2"),
        ("rgb.txt", "nan images/0.png\n", "rgb.txt:1"),
        ("rgb.txt", "# nothing\n", "rgb.txt"),
        ("rgb.txt", b"\xff\xfe\x00\x80", "rgb.txt"),
        ("groundtruth.txt", "# t\n0 1 2 3\n", "groundtruth.txt:2"),
        ("groundtruth.txt", "0 0 0 0 0 0 0 0\n", "groundtruth.txt:1"),
        ("groundtruth.txt", "0 0 0 inf 0 0 0 1\n", "groundtruth.txt:1"),
    ],
)
def test_broken_lines_are_told_with_file_and_line(tum, name, text, place):
    write(tum / name, text)
    with pytest.raises(SourceError, match=place) as caught:
        open_source(str(tum))
    assert len(str(caught.value).splitlines()) == 1


def test_known_kinects_are_recognized_by_the_name_of_the_folder(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg2_desk"
    write_image(folder / "rgb" / "1.png")
    write(folder / "rgb.txt", "1 rgb/1.png\n")
    assert open_source(str(folder)).camera.fx == 520.908620


def test_associations_have_colour_and_depth_in_either_order(tmp_path):
    write_image(tmp_path / "rgb" / "1.png")
    write_image(tmp_path / "depth" / "1.png")
    for line in ("1.0 rgb/1.png 1.01 depth/1.png\n", "1.01 depth/1.png 1.0 rgb/1.png\n"):
        write(tmp_path / "associations.txt", line)
        source = open_source(str(tmp_path))
        assert (source.paths[0].parent.name, source.timestamps_s.tolist()) == ("rgb", [1.0])


def test_icl_nuim_is_reflected_so_that_its_poses_fit_its_images(tmp_path):
    """A camera that turns right and moves up in ICL-NUIM's frame (y up) must do so here (y down)."""
    for i in range(2):
        write_image(tmp_path / "rgb" / f"{i}.png", picture(i, (640, 480)))
    write(tmp_path / "associations.txt", "0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n")
    angle = 0.2
    write(
        tmp_path / "livingRoom0.gt.freiburg",
        f"0 0 0 0 0 0 0 1\n1 0 0.3 0 0 {np.sin(angle / 2)} 0 {np.cos(angle / 2)}\n",
    )
    source = open_source(str(tmp_path))
    assert source.camera == Camera("pinhole", 640, 480, 481.2, 480.0, 319.5, 239.5)
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30])
    pose = source.groundtruth.at(1 / 30)
    assert pose.t.tolist() == [0, -0.3, 0]  # y points down: up is negative
    # The reflection keeps z forward and x right: its optical axis turns towards +x in both frames.
    np.testing.assert_allclose(pose.R[:, 2], [np.sin(angle), 0, np.cos(angle)], atol=1e-12)
    assert np.linalg.det(pose.R) == pytest.approx(1)


@pytest.fixture
def euroc(tmp_path):
    cam0 = tmp_path / "MH_01" / "mav0" / "cam0"
    stamps = [1403636579763555584, 1403636579813555456]
    for i, stamp in enumerate(stamps):
        write_image(cam0 / "data" / f"{stamp}.png", picture(i, channels=1))
    rows = "".join(f"{s},{s}.png\r\n" for s in stamps)
    write(cam0 / "data.csv", "#timestamp [ns],filename\r\n" + rows)
    T_BS = np.eye(4)
    T_BS[:3, :3], T_BS[:3, 3] = YAW_90.R, YAW_90.t
    write(
        cam0 / "sensor.yaml",
        f"T_BS:\n  rows: 4\n  cols: 4\n  data: {T_BS.ravel().tolist()}\nresolution: [64, 48]\n"
        "intrinsics: [60, 61, 31, 23]\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.2, 0.1, 0, 0]\n",
    )
    write(
        cam0.parent / "state_groundtruth_estimate0" / "data.csv",
        "#timestamp, p_RS_R_x [m], ...\n"
        + "".join(f"{s},5,6,7,0.7071067811865476,0.7071067811865476,0,0,0,0,0\n" for s in stamps),
    )
    return cam0.parent.parent


@pytest.mark.parametrize("sub", ["", "mav0", "mav0/cam0"])
def test_euroc_truth_is_that_of_the_camera_whichever_folder_is_named(euroc, sub):
    source = open_source(str(euroc / sub))
    assert (source.kind, source.name, len(source)) == ("euroc", "MH_01", 2)
    assert source.camera == Camera("radtan", 64, 48, 60, 61, 31, 23, (-0.2, 0.1, 0, 0))
    assert source.timestamps_s[0] == 1403636579.763555584
    world_from_body = Pose.from_quaternion(np.array([1.0, 1, 0, 0]), np.array([5.0, 6, 7]))
    expected = world_from_body @ YAW_90
    pose = source.groundtruth.at(source.timestamps_s[1])
    np.testing.assert_allclose(pose.R, expected.R, atol=1e-12)
    np.testing.assert_allclose(pose.t, expected.t, atol=1e-12)
    assert next(source.frames()).image.ndim == 2


def test_euroc_broken_line(euroc):
    write(euroc / "mav0" / "cam0" / "data.csv", "#t\n12.5,a.png\n")
    with pytest.raises(SourceError, match=r"data\.csv:2"):
        open_source(str(euroc))


@pytest.fixture
def kitti(tmp_path):
    sequence = tmp_path / "dataset" / "sequences" / "06"
    for name in ("image_0", "image_2"):
        for i in range(2):
            write_image(sequence / name / f"{i:06d}.png", picture(i, channels=1))
    write(sequence / "times.txt", "0.000000e+00\n1.04e-01\n")
    row = "60 0 31 {} 0 60 23 0 0 0 1 0"
    write(sequence / "calib.txt", f"P0: {row.format(0)}\nP1: {row.format(-30)}\nP2: {row.format(6)}\nTr: 1\n")
    write(tmp_path / "dataset" / "poses" / "06.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 0 0 1 0 0 -1 0 0 2\n")
    return sequence


def test_kitti(kitti):
    source = open_source(str(kitti))
    assert (source.kind, source.name, len(source)) == ("kitti", "06/image_0", 2)
    assert source.camera == Camera("pinhole", 64, 48, 60, 60, 31, 23)
    np.testing.assert_allclose(source.timestamps_s, [0, 0.104])
    assert source.groundtruth.at(0.104).t.tolist() == [0, 0, 2]


def test_kitti_truth_of_another_camera_is_moved_to_it(kitti):
    source = open_source(str(kitti / "image_2"))
    # K [I | t] with K t = (6, 0, 0): cam2_from_cam0 = (0.1, 0, 0), so that cam2 stands at -0.1 in cam0.
    np.testing.assert_allclose(source.groundtruth.at(0.0).t, [-0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(source.groundtruth.at(0.104).t, [0, 0, 2.1], atol=1e-12)


def test_kitti_poses_beside_the_images(kitti):
    (kitti.parents[1] / "poses" / "06.txt").rename(kitti / "poses.txt")
    assert len(open_source(str(kitti)).groundtruth.world_from_cam) == 2


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("times.txt", "0\n", "1 times for 2 images"),
        ("times.txt", "0\nx\n", "times.txt:2"),
        ("times.txt", "1\n0\n", "increase"),
        ("calib.txt", "P1: 1\n", "no line P0"),
        ("calib.txt", "P0: 1 2 3\n", "calib.txt:1"),
        ("calib.txt", "P0: 0 0 0 0 0 0 0 0 0 0 1 0\n", "focal"),
        ("../../poses/06.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 2 images"),
        ("../../poses/06.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n", "not a rotation"),
    ],
)
def test_kitti_broken(kitti, name, text, word):
    write(kitti / name, text)
    with pytest.raises(SourceError, match=word):
        open_source(str(kitti))


def test_image_folder_is_in_natural_order_at_a_nominal_rate(tmp_path):
    for name in ("img10.png", "img2.png", "img1.jpg", ".hidden.png", "notes.txt"):
        write_image(tmp_path / name) if name[-3:] != "txt" else write(tmp_path / name, "no image")
    source = open_source(str(tmp_path))
    assert source.kind == "images" and source.camera is None and source.groundtruth is None
    assert [frame.name for frame in source.frames()] == ["img1.jpg", "img2.png", "img10.png"]
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30, 2 / 30])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["1305031453.359684.png", "1305031453.391690.png"], [1305031453.359684, 1305031453.391690]),
        (
            ["1403715273262142976.png", "1403715273312143104.png"],
            [1403715273.262142976, 1403715273.312143104],
        ),
        (["000012.png", "000013.png"], [0, 1 / 30]),
        (["1305031453.5.png", "1305031453.5.jpg"], [0, 1 / 30]),
    ],
)
def test_names_that_are_times_are_times(tmp_path, names, expected):
    for name in names:
        write_image(tmp_path / "images" / name)
    assert open_source(str(tmp_path)).timestamps_s.tolist() == expected


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (picture(channels=4), picture(channels=4)[..., :3]),
        (picture(channels=1, dtype=np.uint16), (picture(channels=1, dtype=np.uint16) >> 8).astype(np.uint8)),
        (picture(channels=3, dtype=np.uint16), (picture(channels=3, dtype=np.uint16) >> 8).astype(np.uint8)),
        (picture(channels=1), picture(channels=1)),
    ],
)
def test_depth_and_transparency_of_images(tmp_path, image, expected):
    write_image(tmp_path / "a.png", image)
    result = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(result, expected)
    assert result.dtype == np.uint8 and result.flags.c_contiguous


def test_exif_orientation_does_not_turn_the_image(tmp_path):
    write_image(tmp_path / "a.jpg", picture(size=(64, 48)))
    data = (tmp_path / "a.jpg").read_bytes()
    # Orientation (0x0112) = 6: "turn by 90 degrees", in a little-endian TIFF header of one entry.
    tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    write(tmp_path / "a.jpg", data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    # The header is one that OpenCV would obey.
    assert cv2.imread(str(tmp_path / "a.jpg")).shape[:2] == (64, 48)
    assert read_image(tmp_path / "a.jpg").shape[:2] == (48, 64)


def unreadable_images():
    jpeg = cv2.imencode(".jpg", picture(size=(320, 240)))[1].tobytes()
    png = cv2.imencode(".png", picture(size=(320, 240)))[1].tobytes()
    return {
        "empty.png": b"",
        "garbage.png": b"no image at all",
        "cut.jpg": jpeg[: len(jpeg) // 2],
        "cut.png": png[:100],
        "float.tiff": cv2.imencode(".tiff", np.ones((8, 8), np.float32))[1].tobytes(),
    }


@pytest.mark.parametrize("name", unreadable_images())
def test_unreadable_image_is_named_when_it_is_reached_and_not_before(tmp_path, name):
    write_image(tmp_path / "a.png", picture(size=(320, 240)))
    write(tmp_path / f"b_{name}", unreadable_images()[name])
    frames = open_source(str(tmp_path)).frames()
    assert next(frames).index == 0
    with pytest.raises(SourceError, match=f"b_{name}"):
        next(frames)


def test_missing_image_is_named(tum):
    (tum / "images" / "1.png").unlink()
    with pytest.raises(SourceError, match=r"1\.png"):
        list(open_source(str(tum)).frames())


def test_images_of_two_sizes_are_refused(tmp_path):
    write_image(tmp_path / "a.png", picture(size=(64, 48)))
    write_image(tmp_path / "b.png", picture(size=(48, 64)))
    with pytest.raises(SourceError, match=r"b.png.*48x64.*64x48"):
        list(open_source(str(tmp_path)).frames())


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "a video é.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for i in range(7):
        writer.write(np.full((48, 64, 3), 30 * i, np.uint8))
    writer.release()
    return path


def test_video(video):
    source = open_source(str(video))
    assert (source.kind, len(source), source.camera, source.groundtruth) == ("video", 7, None, None)
    frames = list(source.frames(5))
    assert [(f.index, f.timestamp_s, f.name) for f in frames] == [
        (5, 0.25, "frame-000005"),
        (6, 0.3, "frame-000006"),
    ]
    assert abs(frames[0].image.mean() - 150) < 3


@pytest.mark.parametrize("data", [b"", b"garbage" * 100, b"RIFF\0\0\0\0AVI LIST"])
def test_garbage_video(tmp_path, data):
    write(tmp_path / "v.avi", data)
    with pytest.raises(SourceError, match=r"v\.avi"):
        open_source(str(tmp_path / "v.avi"))


def test_synthetic_source_renders_only_what_is_asked_for(monkeypatch):
    import sequences_synth

    rendered = []
    render = sequences_synth.SynthSequence.render
    monkeypatch.setattr(sequences_synth.SynthSequence, "render", lambda self, i: rendered.append(i) or render(self, i))
    source = open_source("synth:wall?frames=20&width=96&height=64", seed=3)
    frames = source.frames(start=4)
    assert [next(frames).index, next(frames).index] == [4, 5]
    assert rendered == [4, 5]
    assert len(source) == 20 and source.camera.width == 96
    assert source.groundtruth.at(float(source.timestamps_s[7])) is not None


def test_synthetic_world_is_the_same_as_the_folder_it_is_written_to(tmp_path):
    from sequences_synth import SynthOptions, make_sequence, write_tum

    write_tum(make_sequence("room", 2, SynthOptions(frames=3, width=96, height=64)), tmp_path / "s")
    read, made = (
        open_source(str(tmp_path / "s")),
        open_source("synth:room?frames=3&width=96&height=64", seed=2),
    )
    assert read.camera == made.camera
    for a, b in zip(read.frames(), made.frames(), strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        true_a, true_b = read.groundtruth.at(a.timestamp_s), made.groundtruth.at(b.timestamp_s)
        np.testing.assert_allclose(true_a.R, true_b.R, atol=1e-7)
        np.testing.assert_allclose(true_a.t, true_b.t, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("synth:nowhere", "room"),
        ("synth:", "room"),
        ("synth:room?magic=1", "magic"),
        ("synth:room?noise=loud", "noise"),
        ("synth:room?frames=0", "frames"),
        ("/no/such/place", "no such"),
        ("", "no sequence|no such"),
        ("a\0b", "cannot be read|no such"),
        ("x" * 5000, "cannot be read|no such"),
    ],
)
def test_sources_that_are_none(text, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SourceError, match=word) as caught:
        open_source(text)
    assert len(str(caught.value).splitlines()) == 1


def test_a_folder_without_a_sequence_is_told_what_was_looked_for(tmp_path):
    with pytest.raises(SourceError, match=r"rgb.txt.*EuRoC.*KITTI.*images"):
        detect_kind(str(tmp_path))
    write_image(tmp_path / "only.png")
    with pytest.raises(SourceError, match="folder"):
        detect_kind(str(tmp_path / "only.png"))


@pytest.mark.parametrize(("start", "count"), [(-1, None), (3, None), (100, 1), (0, 0), (0, -2)])
def test_frames_that_are_not_there(tum, start, count):
    with pytest.raises(SourceError):
        next(open_source(str(tum)).frames(start, count))


REAL = sorted(path.parent for path in DATA.glob("*/*/rgb.txt"))


@pytest.mark.skipif(not REAL, reason="no real sequences: set SLAM_INIT_DATA to their folder")
def test_real_sequences_open_as_they_are():
    for folder in REAL:
        source = open_source(str(folder))
        assert source.kind == "tum" and source.camera is not None and source.groundtruth is not None
        assert all(a < b for a, b in pairwise(source.timestamps_s))
        frame = next(source.frames())
        assert frame.gray.shape == (source.camera.height, source.camera.width)
        assert source.groundtruth.at(frame.timestamp_s) is not None
