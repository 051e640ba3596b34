"""A sample of the mutated files; all of them: ``python -m tests.benchmarks.fuzz``."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.fuzz import __main__ as program
from tests.benchmarks.fuzz.mutations import mutated
from tests.benchmarks.fuzz.targets import TARGETS


@pytest.fixture
def folder(tmp_path, request):
    target = TARGETS[request.getfixturevalue("reader")]
    for name, data in {**target.around(), **target.seeds()}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    return tmp_path


@pytest.mark.parametrize("reader", TARGETS)
def test_the_sound_files_are_read(reader, folder):
    for name in TARGETS[reader].seeds():
        TARGETS[reader].read(folder, name)


@pytest.mark.parametrize("reader", TARGETS)
def test_no_mutated_file_breaks_a_reader(reader, folder):
    found = [program.read_one(reader, 7, index, folder) for index in range(15)]
    assert {what for outcome, what in found if outcome == "broken"} == set()
    assert "refused" in {outcome for outcome, _ in found}


@pytest.mark.parametrize("reader", ["COLMAP"])
def test_what_a_reader_lets_through_is_a_finding(reader, folder, monkeypatch):
    def broken(folder, name):
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setitem(TARGETS, reader, replace(TARGETS[reader], read=broken))
    outcome, what = program.read_one(reader, 0, 0, folder)
    assert outcome == "broken" and "ZeroDivisionError: two lines" in what


def test_inputs_are_read_in_a_child_process_in_their_order():
    told = list(program.fuzz("COLMAP", 0, 3, 6))
    assert [index for index, *_ in told] == [3, 4, 5]
    assert all(outcome in ("read", "refused") for _, outcome, _, _ in told)


def test_the_same_input_has_the_same_mutations():
    first, second = (mutated(b"1 PINHOLE 64 48\n", b"x", np.random.default_rng(5), is_text=True) for _ in range(2))
    assert first == second
