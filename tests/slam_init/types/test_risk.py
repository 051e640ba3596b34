"""Laws of the two parts of a risk: the model's, which is bounded, and what no model has."""

from dataclasses import replace

from make_map import make_map

from slam_init.types.initial_map import UNMODELLED_RISK


def test_a_map_is_never_safer_than_the_rate_of_causes_that_no_model_has():
    map_ = make_map()
    for model in (0.0, 0.001, 0.005):
        assert replace(map_, model_risk=model).risk == model + UNMODELLED_RISK
    assert replace(map_, model_risk=1.0).risk == 1.0


def test_a_method_that_states_no_risk_states_none_of_what_it_lacks():
    assert replace(make_map(), model_risk=None).risk is None
