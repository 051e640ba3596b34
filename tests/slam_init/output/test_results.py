"""Laws of the files of a run: complete, atomic, and readable by evo, COLMAP and gtsam."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import gtsam
import numpy as np
import pycolmap
import pytest
from evo.tools import file_interface
from make_map import CAMERAS, make_map, make_result
from make_scene import CONFIG, cloud, observe, problem
from make_summary import summarize, write_results
from matched_points import map_of_matches
from written import contents

import slam_init
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.focal import camera_with_focal_factor
from slam_init.bundle.reprojection import calibration_key
from slam_init.errors import OutputError, SourceError
from slam_init.mapping.map_building import initial_map
from slam_init.output.names import COLMAP_FILES
from slam_init.output.report import read_result
from slam_init.output.results import load_graph


def write(out, result, **keywords):
    write_results(out, result, summarize(result), **keywords)
    return set(contents(out))


def test_the_configuration_and_the_continuation_lie_beside_the_files_and_nothing_temporary_does(tmp_path):
    map_ = make_map()
    without = write(tmp_path / "a", make_result(map_))
    written = write(tmp_path / "deep" / "run", make_result(map_), config_toml="seed = 0\n", continued=map_.keyframes)
    assert written == without | {"config.toml", "continued.txt"} and len(without) == 10


def test_a_name_that_is_not_unicode_is_written_with_its_bytes(tmp_path):
    map_ = make_map()
    first = replace(map_.keyframes[0], name="\udcff.png")
    write(tmp_path, make_result(replace(map_, keyframes=(first, *map_.keyframes[1:]))))
    assert b" 1 \xff.png\n" in (tmp_path / "colmap" / "images.txt").read_bytes()


def test_evo_reads_the_keyframes_with_the_time_stamps_of_the_source(tmp_path):
    map_ = make_map()
    write(tmp_path, make_result(map_))
    read = file_interface.read_tum_trajectory_file(tmp_path / "trajectory.txt")
    np.testing.assert_array_equal(read.timestamps, [k.timestamp_s for k in map_.keyframes])
    poses = [k.world_from_cam for k in map_.keyframes]
    np.testing.assert_allclose(read.positions_xyz, [p.t for p in poses], atol=1e-11)
    np.testing.assert_allclose([T[:3, :3] for T in read.poses_se3], [p.R for p in poses], atol=1e-10)


@pytest.mark.parametrize("model", ["pinhole", "radtan", "fisheye"])
def test_gtsam_reads_the_graph_and_continues_to_optimize_it(tmp_path, model):
    map_ = make_map(model)
    write(tmp_path, make_result(map_))
    graph, values = load_graph(tmp_path)
    assert graph.equals(map_.graph, 1e-12)
    assert values.equals(map_.values, 1e-12)
    assert graph.error(values) == map_.graph.error(map_.values)
    optimized = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert graph.error(optimized) < graph.error(values)


def test_a_missing_graph_is_an_error(tmp_path):
    with pytest.raises(SourceError, match="no graph in"):
        load_graph(tmp_path)


@pytest.mark.parametrize("model", CAMERAS)
def test_an_adjusted_focal_length_is_in_all_files(tmp_path, model):
    """The graph has the calibration as a variable."""
    rng = np.random.default_rng(2)
    points = cloud(rng, 60)
    noisy = problem(CAMERAS[model], points, noise_px=0.5, rng=rng)
    stated = camera_with_focal_factor(CAMERAS[model], 1.05)
    solution = adjust(stated, noisy, replace(CONFIG.map, refine_focal=True))
    views = observe(CAMERAS[model], noisy.world_from_cam, points, frames=noisy.frames)
    map_ = initial_map(solution, views, "general")
    assert map_.camera == solution.camera != stated
    assert map_.camera.fx == pytest.approx(map_.focal_factor * stated.fx)
    result = make_result(map_)
    write_results(tmp_path, result, summarize(result, camera=stated))

    read = pycolmap.Reconstruction(tmp_path / "colmap")
    np.testing.assert_allclose(read.cameras[1].params[:2], (map_.camera.fx, map_.camera.fy))

    graph, values = load_graph(tmp_path)
    assert graph.equals(solution.recipe.graph, 1e-12)
    assert values.equals(solution.recipe.values, 1e-12)
    assert values.exists(calibration_key())
    assert graph.error(values) == solution.recipe.graph.error(solution.recipe.values)

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["camera"]["fx"] == pytest.approx(stated.fx)
    assert summary["focal_length"] == {
        "fx": pytest.approx(map_.camera.fx),
        "fy": pytest.approx(map_.camera.fy),
        "factor": pytest.approx(map_.focal_factor, rel=1e-5),
        "factor_sigma": pytest.approx(map_.focal_factor_sigma, rel=1e-5),
    }


def test_the_ply_holds_each_landmark_with_its_colour(tmp_path):
    map_ = make_map()
    write(tmp_path, make_result(map_))
    header, body = (tmp_path / "map.ply").read_bytes().split(b"end_header\n", 1)
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b"element vertex 60\n" in header
    vertices = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_allclose(vertices["xyz"], map_.points, atol=1e-6)
    np.testing.assert_array_equal(vertices["rgb"], map_.colors)


def damaged(data, kind, name):
    """A graph as its text is damaged."""
    words, count = data.split(b" "), 8 if name == "graph.txt" else 7
    if kind == "negative count":
        return b" ".join([*words[:count], b"-1", *words[count + 1 :]])
    if kind == "huge count":
        return b" ".join([*words[:count], b"4294967295", *words[count + 1 :]])
    if kind == "cut off":
        return data[: len(data) // 2]
    return {"bad bytes": b"\xff\xfe" + data, "empty": b"", "no archive": b"hello"}[kind]


@pytest.mark.slow
def test_a_damaged_graph_is_reported_in_one_line_and_ends_no_process(tmp_path):
    make_map().save(tmp_path)
    for name in ("graph.txt", "values.txt"):
        sound = (tmp_path / name).read_bytes()
        for kind in ("negative count", "huge count", "cut off", "bad bytes", "empty", "no archive"):
            (tmp_path / name).write_bytes(damaged(sound, kind, name))
            with pytest.raises(SourceError, match="damaged") as message:
                load_graph(tmp_path)
            assert "\n" not in str(message.value)
        (tmp_path / name).write_bytes(sound)


def test_a_graph_that_is_no_file_is_not_waited_for(tmp_path):
    make_map().save(tmp_path)
    graph = tmp_path / "graph.txt"
    for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
        graph.unlink()
        make(graph)
        with pytest.raises(SourceError):
            load_graph(tmp_path)


# -- what somebody holds in Python -----------------------------------------------------------------


@pytest.fixture(scope="module")
def result():
    rng = np.random.default_rng(0)
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    points = rng.uniform((-1.0, -0.8, 2.0), (1.0, 0.8, 4.0), (300, 3))
    views = [(points - (0.2 * k, 0, 0)) @ K.T for k in range(3)]
    return map_of_matches([v[:, :2] / v[:, 2:] + 0.3 * rng.normal(size=(300, 2)) for v in views], K, (640, 480))


def files(folder):
    return set(contents(folder))


def test_a_result_is_saved_with_the_files_of_its_map_and_a_summary(result, tmp_path):
    assert result
    result.save(tmp_path / "result")
    result.map.save(tmp_path / "map")
    assert files(tmp_path / "result") == files(tmp_path / "map") | {"summary.json"}
    assert {"trajectory.txt", "map.ply", "graph.txt", "values.txt", "handover.npz", *COLMAP_FILES} <= files(
        tmp_path / "map"
    )
    for name in files(tmp_path / "map"):
        assert (tmp_path / "result" / name).read_bytes() == (tmp_path / "map" / name).read_bytes()
    graph, _ = slam_init.load_graph(tmp_path / "map")
    assert graph.size() == result.map.graph.size()


def test_a_result_without_a_map_is_saved_with_its_reason(tmp_path):
    slam_init.Initializer(slam_init.prior_camera((64, 48))).finish().save(tmp_path / "none")
    assert '"too_few_frames"' in (tmp_path / "none" / "summary.json").read_text()
    facts = read_result(tmp_path / "none")
    assert facts["version"] and facts["command"] == ["Result.save"]


def test_a_colmap_model_is_written_alone(result, tmp_path):
    slam_init.write_colmap(result.map, tmp_path / "model")
    assert files(tmp_path / "model") == {"cameras.txt", "images.txt", "points3D.txt"}


def test_a_folder_of_another_program_is_refused(result, tmp_path):
    (tmp_path / "map.ply").write_text("mine")
    for save in (result.save, result.map.save, lambda folder: slam_init.write_colmap(result.map, folder)):
        with pytest.raises(OutputError) as message:
            save(tmp_path)
        assert "--" not in str(message.value)
    assert (tmp_path / "map.ply").read_text() == "mine"
