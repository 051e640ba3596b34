"""The camera as people give it: a Camera, a matrix K, or None; anything else is one line."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from make_files import write, write_image
from make_scene import CAMERA

from slam_init import Camera, Config, Initializer, SlamInitError, load_camera, open_source, prior_camera, run
from slam_init.calibration.files import camera_of_size, camera_of_source
from slam_init.errors import CalibrationError, ConfigError
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame, Observations

IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64), dtype=np.uint8)
K = [[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]]


def source(camera=None):
    frames = [Frame(k, float(k), f"{k}", IMAGE) for k in range(2)]

    def read(start=0, max_frames=None):
        return iter(frames[start:])

    return SimpleNamespace(name="two", kind="own", camera=camera, groundtruth=None, frames=read)


@pytest.mark.parametrize(("given", "expected"), [(None, prior_camera((64, 48))), (K, Camera.from_K(K, (64, 48)))])
def test_the_first_image_completes_what_is_given(given, expected):
    initializer = Initializer(given)
    initializer.process(IMAGE)
    assert initializer.camera == expected
    assert camera_of_source(source(), given) == camera_of_size(given, (64, 48)) == expected
    result, _ = run(source(), given)
    assert result.camera == expected


def test_a_first_image_that_is_refused_completes_nothing():
    initializer = Initializer(K)
    with pytest.raises(SlamInitError):
        initializer.process(np.zeros((100, 200), complex))
    with pytest.raises(SlamInitError):
        initializer.process(IMAGE, float("nan"))
    initializer.process(IMAGE)
    assert (initializer.camera.width, initializer.camera.height) == (64, 48)


@pytest.mark.parametrize("given", [5, "f=3", np.zeros((2, 2)), [[1.0]], object()])
def test_anything_else_is_one_line(given):
    for call in (Initializer, lambda camera: run(source(), camera)):
        with pytest.raises(CalibrationError, match="give a Camera") as reported:
            call(given)
        assert "\n" not in str(reported.value)


@pytest.mark.parametrize("arguments", [(CAMERA, 5), (CAMERA, CAMERA), (CAMERA, Config(), "recorder")])
def test_a_wrong_type_of_another_argument_is_one_line(arguments):
    with pytest.raises(ConfigError, match="give camera, Config, Recorder"):
        Initializer(*arguments)


def test_tracks_need_a_camera_that_knows_its_size():
    tracks = Observations(0, 0.0, "", np.arange(3), np.zeros((3, 2)), np.tile([0.0, 0, 1], (3, 1)))
    for given in (None, K):
        with pytest.raises(SlamInitError, match="give the Initializer a Camera"):
            Initializer(given).process_tracks(tracks)


@pytest.mark.parametrize(
    ("matrix", "size", "message"),
    [
        (np.eye(2), (64, 48), "shape"),
        ([[60, 1, 32], [0, 60, 24], [0, 0, 1]], (64, 48), "skew"),
        ([[60, 0, 32], [0, 60, 24], [0, 0, 2]], (64, 48), "last row"),
        (K, (64,), "width, height"),
        (K, ("a", 48), "width, height"),
        ("K", (64, 48), "K has the type str"),
        ([[60, 0, 32], [0, np.nan, 24], [0, 0, 1]], (64, 48), "not finite"),
        (np.array(K).astype(str), (64, 48), "give"),
        (np.ma.masked_less(K, 50), (64, 48), "masked"),
    ],
)
def test_a_matrix_that_is_no_calibration_is_one_line(matrix, size, message):
    with pytest.raises(CalibrationError, match=message):
        Camera.from_K(matrix, size)


def test_intrinsics_of_images_of_another_size_are_refused_unless_they_state_the_size(tmp_path):
    """Resized by a third or more, or cropped on one side by a quarter or more. The frame can be given again."""
    (tmp_path / "without.yaml").write_text("fx: 60\nfy: 61\ncx: 31.5\ncy: 23.5\n")
    for shape in ((24, 32), (32, 43), (72, 96), (48, 48), (32, 64)):
        initializer, image = Initializer(np.array(K)), np.zeros(shape, np.uint8)
        with pytest.raises(CalibrationError, match=r"images of about 64x48, .*resized.*cropped") as reported:
            initializer.process(image)
        assert "\n" not in str(reported.value)
        initializer.process(IMAGE)
        assert (initializer.frames_read, initializer.camera) == (1, Camera.from_K(K, (64, 48)))
        Initializer(Camera.from_K(K, image.shape[::-1])).process(image)
        with pytest.raises(CalibrationError, match=r"without.yaml: .*resized.*cropped"):
            load_camera(tmp_path / "without.yaml", image.shape[::-1])
    assert load_camera(tmp_path / "without.yaml", (64, 48)) == Camera.from_K(K, (64, 48))
    stated = Initializer(Camera.from_K(K, (64, 48)))
    with pytest.raises(SlamInitError, match=r"is 32x24, but the camera is for 64x48: if they are resized.*cropped"):
        stated.process(np.zeros((24, 32), np.uint8))


def test_a_frame_of_another_thread_is_refused_while_one_is_processed():
    initializer = Initializer(prior_camera((64, 48)))
    begun, reported = threading.Event(), []

    class Waits(Recorder):
        def frame(self, *_):
            begun.set()
            other.join()

    def second():
        begun.wait()
        try:
            initializer.process(IMAGE)
        except SlamInitError as error:
            reported.append(str(error))

    initializer.recorder, other = Waits(), threading.Thread(target=second)
    other.start()
    initializer.process(IMAGE)
    initializer.recorder = Recorder()
    initializer.process(IMAGE)
    assert reported == ["another thread is processing a frame: an Initializer is for one thread at a time"]
    assert initializer.frames_read == 2


def test_a_camera_that_contradicts_the_metadata_of_photographs_is_reported_once(tmp_path):
    from PIL import Image

    tags = Image.Exif()
    tags.get_ifd(0x8769)[0xA405] = 28  # FocalLengthIn35mmFilm: 51 px of 66
    for k in range(3):
        Image.new("L", (66, 44), 90 + k).save(tmp_path / f"{k}.jpg", exif=tags)
    photographs = open_source(tmp_path)
    for focal_px, reported in ((20.0, 1), (52.0, 0), (1250.0, 1)):
        matrix = [[focal_px, 0, 32.5], [0, focal_px, 21.5], [0, 0, 1]]
        result, _ = run(photographs, Camera.from_K(matrix, (66, 44)))
        notes = [note for note in result.notes if "metadata" in note]
        assert len(notes) == reported and all(f"{focal_px:.0f} px" in note for note in notes)
    assert not any("metadata of the images" in note for note in run(photographs)[0].notes)


def test_the_camera_txt_beside_images_is_read_unless_a_camera_is_given(tmp_path):
    for k in range(2):
        write_image(tmp_path / "images" / f"{k}.png")
    write(tmp_path / "camera.txt", "60 61 31.5 23.5 0\n64 48\nnone\n64 48\n")
    assert camera_of_source(open_source(tmp_path)) == Camera.from_K(K, (64, 48))
    write(tmp_path / "camera.txt", "0.5 0.6 0.5 0.5 0.93\n64 48\ncrop\n64 48\n")
    assert camera_of_source(open_source(tmp_path)).model == "fov"
    assert camera_of_source(open_source(tmp_path), K) == Camera.from_K(K, (64, 48))
