"""A map and a result that somebody holds in Python are written as a run writes them."""

import numpy as np
import pytest
from matched_points import map_of_matches
from written import contents

import slam_init
from slam_init.errors import OutputError
from slam_init.output.names import COLMAP_FILES
from slam_init.output.report import read_result


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
