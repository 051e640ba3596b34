"""The trials of a plan, in batches of one source."""

from itertools import chain

import pytest

from slam_init.compare.plan import Plan
from slam_init.compare.sources import ComparedSource

SOURCES = tuple(
    ComparedSource(f"clip/{k}", f"clip/{k}", f"/clip/{k}", frames, 30.0, True) for k, frames in enumerate((3, 45, 90))
)
PLAN = Plan(SOURCES, ("quest", "stella"))


@pytest.mark.parametrize("largest", [1, 3, 50])
def test_batches_hold_all_wanted_trials_in_order_and_one_source_each(largest):
    for wanted in (lambda key: True, lambda key: key[1] == "quest" and key[2] != 10, lambda key: False):
        batches = list(PLAN.batches(wanted, largest))
        assert list(chain.from_iterable(batches)) == [trial for trial in PLAN.trials() if wanted(trial.key)]
        assert all(len({trial.source.label for trial in batch}) == 1 for batch in batches)
        assert all(1 <= len(batch) <= largest for batch in batches)


def test_batches_are_made_only_as_they_are_read():
    read = []
    batches = PLAN.batches(lambda key: not read.append(key), 2)
    assert read == []
    next(batches)
    assert len(read) <= 3
