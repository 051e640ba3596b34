"""The attacks on the API hold; those on the command line take a process each and are a program."""

import pytest

from tests.benchmarks.attacks import readers, tables, times, videos
from tests.benchmarks.attacks.api import ATTACKS


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_an_attack_on_the_api_holds(attack, tmp_path):
    seen = attack.run(tmp_path)
    assert seen.holds, seen.text


def test_no_two_attacks_have_one_name():
    names = [a.name for module in (readers, videos, tables, times) for a in module.ATTACKS] + [a.name for a in ATTACKS]
    assert len(set(names)) == len(names) >= 75
