"""Laws of verdicts: they are strings, each refusal has an advice, and a special case comes before a general one."""

import json
import pickle

import pytest

from slam_init.types.reasons import REASONS, Verdict


def test_a_verdict_equals_its_text_and_survives_json_and_pickle():
    assert Verdict("low_parallax") is Verdict.LOW_PARALLAX
    assert Verdict.LOW_PARALLAX == "low_parallax"
    assert json.dumps(Verdict.LOW_PARALLAX) == '"low_parallax"'
    assert f"{Verdict.LOW_PARALLAX}" == "low_parallax"
    for verdict in Verdict:
        assert pickle.loads(pickle.dumps(verdict)) is verdict
    with pytest.raises(ValueError, match="magic"):
        Verdict("magic")


def test_each_refusal_has_an_advice_and_acceptance_has_none():
    assert all(reason.advice for reason in REASONS)
    assert Verdict.ACCEPTED.advice == ""
    assert {*REASONS, Verdict.ACCEPTED} == set(Verdict)


def test_a_static_camera_comes_before_a_rotation_and_a_rotation_before_low_parallax():
    """Each is a special case of the next. A run reports the first of equally frequent reasons."""
    order = [REASONS.index(reason) for reason in (Verdict.STATIC_CAMERA, Verdict.PURE_ROTATION, Verdict.LOW_PARALLAX)]
    assert order == sorted(order)
