"""The two parts of the risk of a map."""

from dataclasses import replace

from make_map import make_map

from slam_init.types.initial_map import UNMODELLED_RISK

MAP = make_map()


def test_a_map_is_never_safer_than_the_rate_of_causes_that_no_model_has_if_it_states_a_risk():
    for model in (0.0, 0.001, 0.005):
        assert replace(MAP, model_risk=model).risk == model + UNMODELLED_RISK
    assert replace(MAP, model_risk=1.0).risk == 1.0
    assert replace(MAP, model_risk=None).risk is None
