"""Which engine a choice gives."""

import pytest

from tests.engines import STEP_NS
from zensim.sim_server.physics.engine_config import (
    EngineConfig,
    EngineMissing,
    EngineOptions,
    choose_engine,
    find_installed_engines,
    parse_engine_name,
)
from zensim.sim_server.physics.engine_factory import create_world_engine

BOTH = ("pybullet", "mujoco")


@pytest.mark.parametrize("name", BOTH)
def test_engine_is_the_one_that_is_asked_for(name: str) -> None:
    choice = EngineOptions(engine=parse_engine_name(name))
    engine = create_world_engine(EngineConfig(STEP_NS), choice, period_steps=3)

    assert engine.name == name
    engine.close()


def test_engine_is_pybullet_when_none_is_asked_for() -> None:
    assert (
        choose_engine(EngineOptions(engine=parse_engine_name("")), find_installed_engines())
        == "pybullet"
    )


def test_engine_that_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ode.*pybullet.*mujoco"):
        parse_engine_name("ode")


def test_engine_is_mujoco_where_pybullet_is_not_installed() -> None:
    assert choose_engine(EngineOptions(), ["mujoco"]) == "mujoco"


def test_both_ways_to_an_engine_are_named_when_none_is_installed() -> None:
    with pytest.raises(EngineMissing, match=r"\[server\].*\[server,mujoco\]"):
        choose_engine(EngineOptions(), [])
