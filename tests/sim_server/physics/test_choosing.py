"""Which engine a choice gives."""

import pytest

from tests.engines import STEP_NS
from zensim.sim_server.physics.choice import (
    EngineChoice,
    EngineMissing,
    engine_named,
    engine_of,
    engines_here,
)
from zensim.sim_server.physics.choosing import chosen_engine
from zensim.sim_server.physics.engine import EngineConfig

BOTH = ("pybullet", "mujoco")


@pytest.mark.parametrize("name", BOTH)
def test_engine_is_the_one_that_is_asked_for(name: str) -> None:
    choice = EngineChoice(engine=engine_named(name))
    engine = chosen_engine(EngineConfig(STEP_NS), choice, period_steps=3)

    assert engine.name == name
    engine.close()


def test_engine_is_pybullet_when_none_is_asked_for() -> None:
    assert engine_of(EngineChoice(engine=engine_named("")), engines_here()) == "pybullet"


def test_engine_that_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="'ode' is unknown; use pybullet or mujoco"):
        engine_named("ode")


def test_engine_is_mujoco_where_pybullet_is_not_installed() -> None:
    assert engine_of(EngineChoice(), ["mujoco"]) == "mujoco"


def test_both_ways_to_an_engine_are_named_when_none_is_installed() -> None:
    with pytest.raises(
        EngineMissing, match=r"\[server\]'.*, or pip.*\[server,mujoco\]' for mujoco"
    ):
        engine_of(EngineChoice(), [])
