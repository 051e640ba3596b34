"""Laws of ``summary.json``: its keys and values."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from make_map import CAMERAS, make_frame, make_map, make_result
from make_summary import summarize

from slam_init.output.plain_json import json_text
from slam_init.output.summary import SCHEMA, InputHash, Summary
from slam_init.types.refusal import GateName, Verdict, at_least
from slam_init.types.result import GroundTruthErrors


def read(summary: Summary):
    """The content of the file, as another program reads it."""
    return json.loads(json_text(summary))


# -- keys and values ------------------------------------------------------------------------------


def test_the_summary_of_a_map_has_its_figures_and_poses():
    map_ = make_map()
    truth = GroundTruthErrors(rotation_error_deg=0.25, direction_error_deg=None, ate_rmse=0.01, path_length=1.5)
    result = make_result(map_)
    content = read(summarize(result, ground_truth=truth))
    assert {
        "schema": SCHEMA,
        "status": "initialized",
        "reason": None,
        "advice": "",
        "frames_read": 32,
        "frames_to_init": 22,
        "landmarks": 60,
        "scene": "general",
        "ground_truth": {
            "rotation_error_deg": 0.25, "direction_error_deg": None, "ate_rmse": 0.01, "path_length": 1.5,
            "scale_error": None, "true_direction_sigma_deg": None, "true_baseline": None,
        },
        "scale": None,
        "scale_sigma": None,
        "scale_origin": None,
        "segments": [],
        "timing_ms": result.timing_ms,
        "method": "quest",
        "seed": 0,
        "continued": None,
        "focal_length": None,
    }.items() <= content.items()  # fmt: skip
    assert [k["frame"] for k in content["keyframes"]] == [10, 17, 24, 31]
    assert content["keyframes"][1]["timestamp"] == map_.keyframes[1].timestamp_s
    np.testing.assert_allclose(content["keyframes"][3]["t"], map_.keyframes[3].world_from_cam.t, atol=1e-8)
    np.testing.assert_allclose(content["keyframes"][3]["q_wxyz"], map_.keyframes[3].world_from_cam.q_wxyz, atol=1e-8)
    assert content["reprojection_rmse_px"] == pytest.approx(map_.reprojection_rmse_px, rel=1e-5)


def test_the_summary_of_an_attempt_has_its_evidence_and_gates():
    attempts = read(summarize(make_result(make_map())))["attempts"]
    assert [(a["frames"], a["verdict"]) for a in attempts][-1] == ([10, 31], "accepted")
    assert attempts[0]["stage"] == "map"
    assert attempts[0]["preview"]["parallax_px"] == 2.5
    assert attempts[0]["two_view"] is None
    assert attempts[0]["window"]["direction_sigma_deg"] == 4.0
    assert attempts[0]["gates"][1] == {
        "name": "risk",
        "value": 0.07,
        "threshold": 0.005,
        "direction": "at_most",
        "unit": "",
        "passes": False,
        "reason": "low_parallax",
        "advice": Verdict.LOW_PARALLAX.advice,
    }


def test_the_summary_without_a_map_has_the_same_keys_and_the_reason():
    summary = summarize(make_result(None, Verdict.LOW_PARALLAX))
    assert (summary.status, summary.reason) == ("not_initialized", "low_parallax")
    assert (summary.keyframes, summary.landmarks, summary.ground_truth) == ((), 0, None)
    assert read(summary).keys() == read(summarize(make_result(make_map()))).keys()
    assert list(read(summary)) == [field.name for field in fields(Summary)]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), np.float64("nan"), np.float32("-inf")])
def test_numbers_that_are_not_finite_are_null(bad):
    result = make_result(make_map())
    evidence = {"noise_px": bad, "count": np.int64(3), "planar": np.bool_(True)}
    gate = at_least(GateName.MOTION_PX, bad, 0.1, Verdict.PURE_ROTATION)
    attempt = replace(result.attempts[0], method_evidence=evidence, gates=(gate,))
    summary = summarize(replace(result, attempts=(attempt,)))
    (content,) = read(summary)["attempts"]
    assert content["method_evidence"] == {"noise_px": None, "count": 3, "planar": True}
    assert content["gates"][0]["value"] is None


# -- the provenance --------------------------------------------------------------------------------

FRAMES = [make_frame(k, k / 30, f"{k}.png") for k in range(3)]


def hash_of(frames, camera=CAMERAS["pinhole"]):
    hashed = InputHash(camera)
    assert list(hashed.reading(iter(frames))) == list(frames)
    return hashed.hexdigest()


def dotted(frame):
    """The same frame with one other pixel."""
    image = frame.image.copy()
    image[7, 5] += 1
    return replace(frame, image=image)


def test_equal_inputs_have_equal_hashes():
    copies = [replace(frame, image=frame.image.copy()) for frame in FRAMES]
    assert hash_of(FRAMES) == hash_of(copies)
    strided = [replace(frame, image=np.asfortranarray(frame.image)) for frame in FRAMES]
    assert hash_of(FRAMES) == hash_of(strided)


def test_each_change_of_the_frames_or_of_the_calibration_changes_the_hash():
    newest = FRAMES[2]
    others = [
        dotted(newest),
        replace(newest, name="other.png"),
        replace(newest, timestamp_s=newest.timestamp_s + 1e-9),
        replace(newest, image=newest.image.reshape(640, 480, 3)),
    ]
    for changed in (*([*FRAMES[:2], other] for other in others), FRAMES[:2], FRAMES[::-1]):
        assert hash_of(changed) != hash_of(FRAMES)
    assert hash_of(FRAMES, replace(CAMERAS["pinhole"], fx=501.0)) != hash_of(FRAMES)


def test_only_frames_that_were_read_are_hashed():
    hashed = InputHash(CAMERAS["pinhole"])
    reading = hashed.reading(iter(FRAMES))
    next(reading)
    next(reading)
    assert hashed.hexdigest() == hash_of(FRAMES[:2])
