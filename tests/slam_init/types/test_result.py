"""The texts of attempts and results."""

from make_map import make_attempts, make_map, make_result

from slam_init.types.refusal import Verdict


def lines_of(described) -> list[str]:
    """The lines of the text; the notebook table has the same content."""
    lines = str(described).split("\n")
    html = described._repr_html_()
    assert html.count("<tr>") == len(lines) - 1
    assert repr(described) == f"<{type(described).__name__}: {lines[0]}>"
    return lines


def test_an_attempt_names_its_verdict_its_advice_and_the_gates_that_failed():
    refused, *_, accepted = make_attempts(make_map())
    lines = lines_of(refused)
    assert lines[0] == "frames 10, 17: low_parallax"
    assert refused.advice in lines[1]
    assert "1 of 2 pass" in lines[2]
    assert [gate.name for gate in refused.failed_gates] == ["risk"]
    assert "risk 0.07" in lines[3]
    assert lines_of(accepted)[1:] == ["  gates       2 of 2 pass"]


def test_a_result_is_truthy_with_a_map_and_names_the_reason_without_one():
    initialized, refused = make_result(make_map()), make_result(None, Verdict.STATIC_CAMERA)
    assert initialized
    assert (initialized.status, refused.status) == ("initialized", "not_initialized")
    assert not refused
    assert lines_of(initialized)[0] == "initialized after 22 frames"
    assert lines_of(refused)[0] == "not initialized: static camera"
    assert Verdict.STATIC_CAMERA.advice in lines_of(refused)[1]
