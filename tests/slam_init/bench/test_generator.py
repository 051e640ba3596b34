"""The suite ``other``: worlds of a generator that is given by its folder become archives of tracks that are judged."""

import json
import textwrap

import numpy as np
import pytest
from paths import DATA
from written import contents

from slam_init.bench.command import Execution, run_bench
from slam_init.bench.generator import draw_archives
from slam_init.bench.leaderboard import read_entries
from slam_init.bench.protocol import DEFAULTS, Run, check_frozen, frozen_key, other_seeds
from slam_init.cli import main
from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.errors import SourceError
from slam_init.output.plain_json import parsed

#: Five views of a cloud, each frame with the tracks of its own; every third seed is static, seed 10004 has no world.
GENERATOR = """
import numpy as np

def draw_factors(seed):
    return {"seed": seed, "scene": "cloud", "traj": "static" if seed % 3 == 0 else "strafe", "baseline": 0.2}

def make(factors):
    if factors["seed"] == 10004:
        return None
    rng = np.random.default_rng(factors["seed"])
    X, still = rng.uniform((-1, -1, 2), (1, 1, 6), (80, 3)), factors["traj"] == "static"
    poses = [(np.eye(3), np.array([0.0 if still else 0.1 * k, 0.0, 0.0])) for k in range(5)]
    frames = []
    for k, (R, t) in enumerate(poses):
        Y = (X - t) @ R
        ids = np.arange(k, 80)
        pixels = 300 * Y[ids, :2] / Y[ids, 2:] + (319.5, 239.5) + rng.normal(0, 0.3, (len(ids), 2))
        frames.append((k, k / 10, ids, pixels))
    return dict(W=640, H=480, fs=300.0, cs=(319.5, 239.5), frames=frames, poses=poses, notrans=still)
"""
RUN = Run("other", 6, 0, DEFAULTS["other"].every, (), ("stella", "a=command:sh x.sh {images} {out}"), "clouds")
#: A generator of somebody else, beside the data.
OTHER = DATA.parent / "tools" / "other_worlds"


def generator(folder, text=GENERATOR):
    folder.mkdir(parents=True)
    (folder / "gen.py").write_text(textwrap.dedent(text))
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    place = tmp_path_factory.mktemp("other")
    made = generator(place / "clouds")
    return made, place / "out", run_bench(RUN, place / "out", Execution(backend="sequential"), made)


def test_an_archive_has_the_tracks_the_calibration_and_the_poses_of_its_world(finished):
    source = open_compared(str(finished[1] / "tracks" / "10001.npz"))
    assert (source.camera.width, source.camera.fx, source.camera.cx) == (640, 300.0, 319.5)
    observed = list(source.observations())
    assert [one.track_ids.tolist() for one in observed] == [list(range(k, 80)) for k in range(5)]
    assert [one.timestamp_s for one in observed] == pytest.approx([k / 10 for k in range(5)])
    truth = source.groundtruth.world_from_cam
    np.testing.assert_allclose([pose.t[0] for pose in truth], [0.1 * k for k in range(5)], atol=1e-12)


def test_a_shorter_run_is_a_part_of_a_longer_one_and_an_archive_has_the_same_bytes_again(finished, tmp_path):
    made, out, _ = finished
    draw_archives(made, 3, 0, tmp_path / "again")
    again, whole = contents(tmp_path / "again"), contents(out)
    assert set(again) == {f"tracks/{seed}.npz" for seed in other_seeds(3, 0)}
    assert again.items() <= whole.items()
    assert not set(other_seeds(1000, 0)) & set(other_seeds(1000, 1))


def test_the_sheet_has_the_factors_of_the_generator_as_strata_and_no_map_without_translation_is_right(finished):
    _, out, text = finished
    sheet = json.loads((out / "sheet.json").read_text())
    assert [one["judged_by"] for one in map(json.loads, (out / "trials.jsonl").read_text().splitlines()[1:])].count(
        "every map is false"
    ) == len([seed for seed in other_seeds(6, 0) if seed % 3 == 0])
    counts = {(one["kind"], one["axis"], one["value"]): one["cells"][0]["trials"] for one in sheet["strata"]}
    assert counts["clouds", "", None] == counts["clouds", "traj", "strafe"] == 3
    assert counts["no translation", "traj", "static"] == 2
    assert counts["clouds", "baseline", "0.2"] == 3
    assert "clouds has no world of the seeds 10004" in text
    assert "baseline / depth 0.2" in text and "not applicable: a on 5 points: sources" in text
    assert sheet["command"].startswith("slam-init bench --suite other --worlds 6 --generator clouds ")


def test_the_sheet_is_read_back_with_factors_that_are_texts(finished):
    (first, _) = read_entries(str(finished[1]))
    assert (first.suite, first.row.label, first.row.trials) == ("other", "stella", 5)
    assert parsed(type(RUN), json.dumps({**vars(RUN), "methods": ["a"], "sequences": []})).generator == "clouds"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "no gen.py: the suite other is skipped"),
        ("def make(factors): return None", "has no attribute 'draw_factors'"),
        ("raise SystemExit('not here')", "not here"),
        ("def draw_factors(seed): return {}\ndef make(factors): return None", "has no world of the seeds"),
        ("def draw_factors(seed): return {}\ndef make(factors): return {'W': 3}", "seed 10000: 'frames'"),
    ],
)
def test_a_folder_that_draws_no_world_is_one_line_and_leaves_nothing(text, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        generator(tmp_path / "theirs", text)
    assert main(["bench", "--suite", "other", "--generator", "theirs", "--worlds", "2", "--methods", "stella"]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
    assert not (tmp_path / "slam-init-bench").exists()


@pytest.mark.parametrize(
    "words", [["--suite", "other"], ["--generator", "."], ["--suite", "other", "--generator", ".", "--every", "2"]]
)
def test_the_suite_and_its_generator_belong_together(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *words]) == 2
    assert "belong" in capsys.readouterr().err and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not (OTHER / "gen.py").is_file(), reason="no tools/other_worlds beside SLAM_INIT_DATA")
def test_the_tracks_of_the_generator_of_the_published_table_are_the_frozen_ones(tmp_path):
    sources, _ = draw_archives(OTHER, 3, 0, tmp_path / "out")
    opened = {source.label: open_compared(source.text) for source in sources}
    check = check_frozen("other", {name: tracks_digest(one, replay(one, "", 0, "")) for name, one in opened.items()})
    assert (check.same, check.different, check.unknown) == (3, (), 0)
    assert {frozen_key("other", source.label) for source in sources} == {
        f"points:other_worlds/{seed}" for seed in other_seeds(3, 0)
    }


def test_the_archives_of_a_generator_that_fails_later_are_not_left(tmp_path):
    text = GENERATOR.replace("return None", "raise ValueError('no such scene')")
    with pytest.raises(SourceError, match=r"gen.py: seed 10004: no such scene"):
        draw_archives(generator(tmp_path / "theirs", text), 6, 0, tmp_path / "out")
    assert not (tmp_path / "out").exists()
