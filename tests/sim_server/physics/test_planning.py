"""Plans: a model once while it is the last; what cannot be built is refused each time."""

import pytest

from tests.models import a_box, a_cart
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.blueprint import blueprint_of
from zensim.sim_server.physics.engine import EngineRefused
from zensim.sim_server.physics.planning import Planner


def a_planner(max_parts: int = 128) -> Planner:
    return Planner(
        "mine", max_parts=max_parts, joint_kinds=("fixed", "continuous"), shape_kinds=("box",)
    )


def test_model_is_planned_once_while_it_is_the_last() -> None:
    planner, model = a_planner(), a_box()

    first = planner.blueprint(model)

    assert first == blueprint_of(model)
    assert planner.blueprint(model) is first


def test_another_model_is_planned_by_itself() -> None:
    planner, box = a_planner(), a_box()
    planner.blueprint(box)

    found = planner.blueprint(Model("other", box.links))

    assert found.name == "other"


def test_model_that_cannot_be_built_is_refused_each_time() -> None:
    planner, model = a_planner(max_parts=1), a_cart()

    for _ in range(2):
        with pytest.raises(EngineRefused, match="use at most 1"):
            planner.blueprint(model)
