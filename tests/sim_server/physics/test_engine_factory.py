"""Choice of an engine."""

from collections.abc import Sequence

import pytest

from tests.engines import STEP_NS
from zensim.proto.engine_proofs import EngineName
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.physics.engine_config import (
    EngineConfig,
    EngineMissing,
    choose_engine,
    explain_default,
    find_installed_engines,
    parse_engine_name,
)
from zensim.sim_server.physics.engine_factory import create_world_engine

BOTH: tuple[EngineName, EngineName] = ("pybullet", "mujoco")


@pytest.mark.parametrize("name", BOTH)
def test_chosen_engine_is_created(name: str) -> None:
    choice = EngineSettings(engine=parse_engine_name(name))
    engine = create_world_engine(EngineConfig(STEP_NS), choice, period_steps=3)

    assert engine.name == name
    engine.close()


def test_engine_defaults_to_pybullet() -> None:
    assert (
        choose_engine(EngineSettings(engine=parse_engine_name("")), find_installed_engines())
        == "pybullet"
    )


def test_unknown_engine_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ode.*pybullet.*mujoco"):
        parse_engine_name("ode")


def test_engine_defaults_to_mujoco_without_pybullet() -> None:
    assert choose_engine(EngineSettings(), ["mujoco"]) == "mujoco"


def test_default_engine_without_pybullet_has_a_reason() -> None:
    reason = explain_default(EngineSettings(), ["mujoco"])

    assert reason is not None
    assert all(word in reason for word in ("pybullet", "mujoco", "[server]"))


@pytest.mark.parametrize(
    ("choice", "installed"),
    [(EngineSettings(), BOTH), (EngineSettings(), ()), (EngineSettings(engine="mujoco"), BOTH[1:])],
)
def test_first_and_chosen_engines_have_no_reason(
    choice: EngineSettings, installed: Sequence[EngineName]
) -> None:
    assert explain_default(choice, installed) is None


def test_reason_says_where_pybullet_has_no_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "riscv64")

    reason = explain_default(EngineSettings(), ["mujoco"])

    assert reason is not None
    assert "riscv64" in reason
    assert "pip install" not in reason


def test_error_names_the_extra_when_no_engine_is_installed() -> None:
    with pytest.raises(EngineMissing, match=r"\[server\]"):
        choose_engine(EngineSettings(), [])


def test_error_names_slug_and_the_extra_when_the_chosen_engine_is_not_installed() -> None:
    with pytest.raises(EngineMissing, match=r"^engine\.missing: .*`engine` mujoco.*\[server\]"):
        choose_engine(EngineSettings(engine="pybullet"), ["mujoco"])


def test_error_names_no_command_where_pybullet_has_no_wheel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("platform.machine", lambda: "riscv64")

    with pytest.raises(EngineMissing, match=r"`engine` mujoco.*riscv64$"):
        choose_engine(EngineSettings(engine="pybullet"), ["mujoco"])
