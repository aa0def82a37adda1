"""Engines prove themselves once for each build; those that fail are refused."""

import json
import logging
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest

import zensim
from tests.engines import STEP_NS
from tests.wrong_trials import CountedTrials
from zensim.proto import engine_proofs
from zensim.proto.child_process import make_module_command, run_process
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import CellConfig, create_world_engine
from zensim.sim_server.physics.engine_proof.engine_prover import (
    TRIALS,
    EngineFailed,
    choose_proven_engine,
    prove_engine,
)
from zensim.sim_server.server_config import ConfigError, ServerConfig, validate_config

MUJOCO = EngineSettings(engine="mujoco")
ALLOWED = msgspec.structs.replace(MUJOCO, allow_failed_engine=True)


@pytest.fixture(autouse=True)
def proofs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give proofs a folder of their own, which does not exist yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    use(monkeypatch, "CountedTrials")
    yield tmp_path / "caches" / "zensim" / "engine_proofs"
    prove_engine.cache_clear()


def use(monkeypatch: pytest.MonkeyPatch, class_name: str) -> None:
    """Start with an engine as a new process does."""
    monkeypatch.setitem(TRIALS, "mujoco", ("tests.wrong_trials", class_name))
    CountedTrials.made.clear()
    prove_engine.cache_clear()


def start_again(choice: EngineSettings = MUJOCO) -> int:
    """Start as a new process does; return how often the cases ran."""
    CountedTrials.made.clear()
    prove_engine.cache_clear()
    choose_proven_engine(choice)
    return len(CountedTrials.made)


def test_first_start_runs_the_cases_and_a_second_one_does_not(proofs: Path) -> None:
    assert start_again() == 1
    assert start_again() == 0
    assert len(list(proofs.iterdir())) == 1


def test_second_world_of_a_process_reads_nothing(proofs: Path) -> None:
    choose_proven_engine(MUJOCO)
    for file in proofs.iterdir():
        file.unlink()

    choose_proven_engine(MUJOCO)

    assert CountedTrials.made == ["CountedTrials"]


def test_other_version_of_an_engine_runs_the_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    start_again()

    monkeypatch.setattr(engine_proofs, "find_package_version", lambda _: "99.1")

    assert start_again() == 1
    assert start_again() == 0


def test_engine_that_fails_is_refused_with_version_case_and_ways_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    use(monkeypatch, "SlipperyGround")
    version = engine_proofs.find_engine_build("mujoco").version

    with pytest.raises(EngineFailed) as caught:
        choose_proven_engine(MUJOCO)

    line = str(caught.value)
    assert line.startswith("engine.failed: ")
    assert len(line.splitlines()) == 1
    for word in (version, "block that slides", "zensim[server]", "`allow_failed_engine`"):
        assert word in line


def test_every_road_to_a_world_refuses_an_engine_that_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    use(monkeypatch, "SlowPendulum")

    with pytest.raises(ConfigError, match=r"^engine\.failed: "):
        validate_config(ServerConfig(settings=ServerSettings(physics=MUJOCO)))
    with pytest.raises(EngineFailed):
        create_world_engine(EngineConfig(STEP_NS), MUJOCO, period_steps=1)
    with pytest.raises(zensim.Invalid, match=r"^engine\.failed: "):
        zensim.World(engine="mujoco")


def test_engine_that_fails_can_be_allowed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    use(monkeypatch, "SlowPendulum")

    with caplog.at_level(logging.WARNING), zensim.World(allow_failed_engine=True) as world:
        world.step()

    assert "pendulum" in caplog.text
    engine = create_world_engine(EngineConfig(STEP_NS), ALLOWED, period_steps=1)
    engine.close()


def test_failed_proof_is_kept_and_tried_again(
    monkeypatch: pytest.MonkeyPatch, proofs: Path
) -> None:
    use(monkeypatch, "SaggingArm")
    choose_proven_engine(ALLOWED)
    kept = json.loads(next(proofs.iterdir()).read_bytes())

    assert {"held arm"} <= {case["case"] for case in kept["cases"]}
    assert start_again(ALLOWED) == 1
    use(monkeypatch, "CountedTrials")
    assert start_again() == 1
    assert start_again() == 0


def test_library_that_cannot_be_loaded_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, "CountedTrials")
    monkeypatch.setitem(TRIALS, "mujoco", ("tests.no_such_trials", "NoTrials"))

    with pytest.raises(EngineFailed, match="no_such_trials"):
        choose_proven_engine(MUJOCO)


@pytest.mark.parametrize("is_file", [True, False], ids=["a file", "no home"])
def test_cache_that_cannot_be_written_is_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, is_file: bool
) -> None:
    if is_file:
        (tmp_path / "caches").write_text("not a folder")
    else:
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setattr(Path, "home", refuse_home)

    assert start_again() == 1
    assert start_again() == 1


def refuse_home() -> Path:
    raise RuntimeError("Could not determine home directory.")


def test_damaged_proof_is_made_again(proofs: Path) -> None:
    start_again()
    file = next(proofs.iterdir())
    file.write_bytes(file.read_bytes()[:-7])

    assert start_again() == 1
    assert start_again() == 0


def test_processes_that_start_at_once_leave_one_whole_proof(proofs: Path) -> None:
    command = make_module_command("tests.sim_server.physics.engine_proof.prove_once")
    with ThreadPoolExecutor(3) as threads:
        outcomes = list(threads.map(lambda _: run_process(command, b"", timeout_s=60.0), range(3)))

    assert [outcome.status for outcome in outcomes] == [0, 0, 0]
    assert len(list(proofs.iterdir())) == 1
    kept = engine_proofs.read_proof(engine_proofs.find_engine_build("mujoco"))
    assert kept is not None
    assert kept.failed is None


def test_engine_of_a_cell_is_not_proved() -> None:
    CellConfig("mujoco", EngineConfig(STEP_NS)).make().close()

    assert CountedTrials.made == []
