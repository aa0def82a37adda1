"""Choice of an engine."""

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
def test_chosen_engine_is_created(name: str) -> None:
    choice = EngineOptions(engine=parse_engine_name(name))
    engine = create_world_engine(EngineConfig(STEP_NS), choice, period_steps=3)

    assert engine.name == name
    engine.close()


def test_engine_defaults_to_pybullet() -> None:
    assert (
        choose_engine(EngineOptions(engine=parse_engine_name("")), find_installed_engines())
        == "pybullet"
    )


def test_unknown_engine_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ode.*pybullet.*mujoco"):
        parse_engine_name("ode")


def test_engine_defaults_to_mujoco_without_pybullet() -> None:
    assert choose_engine(EngineOptions(), ["mujoco"]) == "mujoco"


def test_error_names_both_install_commands_when_none_is_installed() -> None:
    with pytest.raises(EngineMissing, match=r"\[pybullet\].*\[server\]"):
        choose_engine(EngineOptions(), [])


def test_error_names_slug_and_the_extra_when_the_chosen_engine_is_not_installed() -> None:
    with pytest.raises(EngineMissing, match=r"^engine\.missing: .*--engine mujoco.*\[pybullet\]"):
        choose_engine(EngineOptions(engine="pybullet"), ["mujoco"])
