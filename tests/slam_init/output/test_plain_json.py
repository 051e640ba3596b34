"""Laws of the conversion to plain JSON types."""

from dataclasses import dataclass, field

import numpy as np

from slam_init.output.plain_json import plain, plain_fields
from slam_init.types.refusal import Verdict


@dataclass(frozen=True)
class Inner:
    exact: float = field(metadata={"digits": 9})
    rounded: float


@dataclass(frozen=True)
class Outer:
    inner: Inner
    verdict: Verdict
    values: tuple[float, ...]


def test_floats_are_rounded_to_the_digits_of_their_field():
    value = 1 / 3 + 100
    assert plain(Inner(value, value)) == {"exact": 100.333333, "rounded": 100.333}
    assert plain(value) == 100.333
    assert plain(value, 3) == 100.0


def test_numpy_values_mappings_and_numbers_that_are_not_finite_are_converted():
    for value, expected in (
        (np.float32("nan"), None),
        (float("-inf"), None),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.array([[1, 2]]), [[1, 2]]),
        ({1: Verdict.ACCEPTED}, {"1": "accepted"}),
        (None, None),
    ):
        assert plain(value) == expected
        assert type(plain(value)) is type(expected)


def test_the_fields_of_a_dataclass_are_converted_by_name():
    assert plain_fields(Inner(0.5, 0.25)) == {"exact": 0.5, "rounded": 0.25}
