"""The suite of public sequences, its converters, and external programs in it."""

import json
import sys

import cv2
import numpy as np
import pytest

from slam_init.bench.command import Execution, run_bench
from slam_init.bench.convert import convert
from slam_init.bench.manifest import checksum, find_sequences
from slam_init.bench.protocol import Run
from slam_init.compare.sources import describe_sources
from slam_init.compare.trajectories import write_trajectory
from slam_init.datasets import open_source
from slam_init.errors import SlamInitError, SourceError
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose, Trajectory

COUNT = 3
R = cv2.Rodrigues(np.array([0.1, -0.2, 0.05]))[0]


def images(folder, names, size=(640, 480)):
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for name in names:
        cv2.imwrite(str(folder / name), rng.integers(0, 255, (size[1], size[0]), np.uint8))


def text(values):
    return "\n".join(" ".join(map(repr, map(float, row))) for row in np.atleast_2d(values)) + "\n"


def true_poses():
    return [Pose(np.linalg.matrix_power(R, i), np.array([0.1 * i, 0.2, -0.3 * i])) for i in range(COUNT)]


def seven_scenes(folder):
    images(folder, [f"frame-{i:06d}.color.png" for i in range(COUNT + 1)])
    for i, pose in enumerate(true_poses()):
        matrix = np.vstack([np.column_stack([pose.R, pose.t]), [0, 0, 0, 1]])
        (folder / f"frame-{i:06d}.pose.txt").write_text(text(matrix))
    (folder / f"frame-{COUNT:06d}.pose.txt").write_text("-nan inf inf inf\n" * 4)  # tracking was lost


def tartanair(folder):
    images(folder / "image_left", [f"{i:06d}_left.png" for i in range(COUNT)])
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    bodies = [Pose(axes @ pose.R @ axes.T, axes @ pose.t) for pose in true_poses()]
    rows = [[*body.t, *body.q_wxyz[1:], body.q_wxyz[0]] for body in bodies]
    (folder / "pose_left.txt").write_text(text(rows))


def middlebury(folder):
    names = [f"temple{i:04d}.png" for i in range(COUNT)]
    images(folder, names)
    K = [[1520.4, 0, 302.3], [0, 1525.9, 246.9], [0, 0, 1]]
    rows = []
    for name, pose in zip(names, true_poses(), strict=True):
        inverse = pose.inverse()
        rows.append(f"{name} " + text(np.concatenate([np.ravel(K), inverse.R.ravel(), inverse.t])).strip())
    (folder / "temple_par.txt").write_text(f"{COUNT + 1}\n" + "\n".join(rows) + "\n")


def strecha(folder):
    names = [f"{i:04d}.png" for i in range(COUNT)]
    images(folder / "images", names)
    for name, pose in zip(names, true_poses(), strict=True):
        K = [[900.0, 0, 320], [0, 901.0, 240], [0, 0, 1]]
        rows = text(K) + "0 0 0\n" + text(pose.R) + text(pose.t) + "640 480\n"
        (folder / "gt").mkdir(exist_ok=True)
        (folder / "gt" / f"{name}.camera").write_text(rows)


def uzh(folder):
    images(folder / "images", [f"img_{i:04d}.png" for i in range(COUNT)])
    (folder / "K.txt").write_text(text([[420.0, 0, 355], [0, 420.0, 250], [0, 0, 1]]))
    (folder / "D.txt").write_text("-1.6e-06 2.5e-12\n")
    inverses = [pose.inverse() for pose in true_poses()]
    (folder / "poses.txt").write_text(text([[*cv2.Rodrigues(p.R)[0].ravel(), *p.t] for p in inverses]))


def colmap(folder):
    images(folder / "images", [f"{i}.png" for i in range(COUNT)])
    (folder / "cameras.txt").write_text("1 SIMPLE_RADIAL 640 480 700 320.5 240.5 0.01\n")
    rows = []
    for i, pose in enumerate(true_poses()):
        inverse = pose.inverse()
        rows.append(f"{i + 1} {text([[*inverse.q_wxyz, *inverse.t]]).strip()} 1 {i}.png\n1.0 2.0 -1\n")
    (folder / "images.txt").write_text("".join(rows))


LAYOUTS = (seven_scenes, tartanair, middlebury, strecha, uzh, colmap)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_published_layout_becomes_a_sequence_with_the_same_poses(layout, tmp_path):
    name = layout.__name__.replace("seven_scenes", "7scenes")
    layout(tmp_path / "in")
    convert(name, tmp_path / "in", tmp_path / "out")
    source = open_source(tmp_path / "out")
    assert len(source) == COUNT and source.camera is not None
    for stamp, true in zip(source.timestamps_s, true_poses(), strict=True):
        pose = source.groundtruth.at(stamp)
        assert np.allclose(pose.R, true.R, atol=1e-6) and np.allclose(pose.t, true.t, atol=1e-6)
    convert("read", tmp_path / "out", tmp_path / "again")
    assert checksum(tmp_path / "again") == checksum(tmp_path / "out")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_folder_of_another_layout_is_told_in_one_line(layout, tmp_path):
    name = layout.__name__.replace("seven_scenes", "7scenes")
    (tmp_path / "in").mkdir()
    with pytest.raises(SlamInitError) as error:
        convert(name, tmp_path / "in", tmp_path / "out")
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()


def test_a_calibration_of_another_size_is_refused(tmp_path):
    seven_scenes(tmp_path / "in")
    images(tmp_path / "in", [f"frame-{i:06d}.color.png" for i in range(COUNT)], (320, 240))
    with pytest.raises(SourceError, match="320x240"):
        convert("7scenes", tmp_path / "in", tmp_path / "out")


def video_folder(root):
    """A public sequence of three frames under its name in the manifest."""
    tartanair(root / "in")
    convert("tartanair", root / "in", root / "data" / "hospital_clip")
    return root / "data"


def test_a_checksum_changes_with_an_image_and_with_the_truth(tmp_path):
    folder = video_folder(tmp_path) / "hospital_clip"
    first = checksum(folder)
    assert find_sequences(tmp_path / "data").found == {"hospital_clip": folder}
    images(folder / "images", ["000001.png"])
    with_image = checksum(folder)
    (folder / "groundtruth.txt").write_text((folder / "groundtruth.txt").read_text() + "# more\n")
    assert len({first, with_image, checksum(folder)}) == 3


def test_two_folders_of_one_name_are_refused(tmp_path):
    data = video_folder(tmp_path)
    convert("read", data / "hospital_clip", data / "copy" / "hospital_clip")
    with pytest.raises(SourceError, match="same name"):
        find_sequences(data)


def test_an_external_program_runs_in_the_benchmark_and_its_trajectory_is_written(tmp_path, monkeypatch):
    data = video_folder(tmp_path)
    monkeypatch.setenv("SLAM_INIT_DATA", str(data))
    truth = data / "hospital_clip" / "groundtruth.txt"
    copies = f"import shutil, sys; shutil.copy({str(truth)!r}, sys.argv[2] + '/trajectory.txt')"
    fails = "import sys; sys.exit('no GPU')"
    program = f'{sys.executable} -c "{{}}" {{{{images}}}} {{{{out}}}}'
    methods = (f"copies=command:{program.format(copies)}", f"fails=command:{program.format(fails)}")
    run = Run("video", 0, 0, 20, (), methods)
    out = tmp_path / "out"
    told = run_bench(run, out, Execution(backend="sequential", trajectories=True))
    sheet = json.loads((out / "sheet.json").read_text())
    # Random images have no map of their own: the truth as an answer is correct.
    assert [row["label"] for row in sheet["rows"]] == ["copies", "fails"]
    assert [row["correct"][0] for row in sheet["rows"]] == [1.0, 0.0]
    assert [row["errors"] for row in sheet["rows"]] == [0, 1]
    assert "not those of the manifest" in told
    lab = out / "trajectories" / "vslam-lab" / "copies" / "SLAM-INIT" / "hospital_clip"
    header, *rows = (lab / "00000_KeyFrameTrajectory.csv").read_text().splitlines()
    assert header == "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw" and len(rows) == COUNT
    assert [row.split(",")[0] for row in rows] == ["0", "100000000", "200000000"]
    assert (lab / "groundtruth.csv").is_file()
    rows = [json.loads(line) for line in (out / "trials.jsonl").read_text().splitlines()[1:]]
    assert [row["reason"] for row in rows if row["outcome"] == "error"] == ["fails exited with 1: no GPU"]


def test_an_external_program_is_left_out_on_tracks_without_images(tmp_path):
    method = f"own=command:{sys.executable} {{images}} {{out}}"
    told = run_bench(Run("drawn", 2, 0, 10_000, (), ("stella", method)), tmp_path, Execution(backend="sequential"))
    assert "not applicable: own on 2 points: sources" in told
    own = json.loads((tmp_path / "sheet.json").read_text())["rows"][1]
    assert (own["trials"], own["not_applicable"], own["correct"][0]) == (0, 2, None)


def test_evo_reads_the_trajectories(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    poses = true_poses()
    truth = Trajectory(np.arange(COUNT) / 10, tuple(poses))
    keyframes = [Keyframe(i, i / 10, "", pose) for i, pose in enumerate(poses)]
    write_trajectory(tmp_path, "quest", "a/b", 5, keyframes, truth)
    read = file_interface.read_tum_trajectory_file(str(tmp_path / "evo" / "quest" / "a_2Fb" / "00005.txt"))
    assert np.allclose(read.positions_xyz, [pose.t for pose in poses])


def test_labels_of_described_sources_are_kept_by_compare(tmp_path):
    folder = video_folder(tmp_path) / "hospital_clip"
    assert describe_sources([str(folder)])[0].label == folder.as_posix()
