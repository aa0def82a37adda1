"""A server whose engine has one wrong answer: it is refused, or used where that is allowed."""

import os
from pathlib import Path

import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import free_endpoint, serving, zensim
from zensim.proto.exit_codes import ExitCode

USE_WRONG_ANSWERS = """
from zensim.sim_server.physics.engine_proof import engine_prover
engine_prover.TRIALS["mujoco"] = ("tests.wrong_trials", "SlipperyGround")
"""


@pytest.fixture
def prefix(tmp_path: Path) -> tuple[str, ...]:
    """Make every process prove MuJoCo with a wrong answer, in a cache of its own."""
    (tmp_path / "sitecustomize.py").write_text(USE_WRONG_ANSWERS, encoding="utf-8")
    path = os.pathsep.join((str(tmp_path), str(ROOT)))
    return ("env", f"PYTHONPATH={path}", f"XDG_CACHE_HOME={tmp_path / 'caches'}")


@pytest.mark.parametrize(
    "words",
    [
        ("serve", "--engine", "mujoco"),
        ("up", "--engine", "mujoco", "--robots", "0", "--no-viewer"),
        ("check", "--engine", "mujoco", "box_bot"),
        ("world", "inspect", "walls", "--engine", "mujoco", "--settle", "0.1"),
    ],
    ids=lambda words: words[0],
)
def test_command_refuses_an_engine_that_fails(
    words: tuple[str, ...], prefix: tuple[str, ...]
) -> None:
    at = ("--listen", free_endpoint()) if words[0] in ("serve", "up") else ()

    done = zensim(*words, *at, prefix=prefix)

    assert done.returncode != ExitCode.OK
    assert "engine.failed: mujoco " in done.stderr
    assert "block that slides" in done.stderr
    assert done.stderr.count("block that slides") == 1


def test_server_and_doctor_run_with_a_failed_engine_that_is_allowed(
    prefix: tuple[str, ...],
) -> None:
    with serving("--engine", "mujoco", "--allow-failed-engine", prefix=prefix) as server:
        assert server.client.info().engine == "mujoco"

        doctor = zensim("doctor", "--connect", server.endpoint, prefix=prefix)

    assert "block that slides" in doctor.stdout
    assert doctor.returncode == ExitCode.FAILED


def test_variable_allows_a_failed_engine(prefix: tuple[str, ...]) -> None:
    allowed = (*prefix, "ZENSIM_ALLOW_FAILED_ENGINE=1")

    with serving("--engine", "mujoco", prefix=allowed) as server:
        assert server.client.info().engine == "mujoco"


def test_scenario_allows_a_failed_engine(prefix: tuple[str, ...], tmp_path: Path) -> None:
    file = tmp_path / "walls.scenario.yaml"
    file.write_text(
        "zensim: 1\nworld: {load: empty}\nengine: {use: mujoco, allow_failed: true}\n"
        "end: {at: 0.1 s}\n",
        encoding="utf-8",
    )

    refused = zensim("test", str(file), "--set", "engine.allow_failed=false", prefix=prefix)
    passed = zensim("test", str(file), prefix=prefix)

    assert refused.returncode != ExitCode.OK
    assert "engine.failed" in refused.stdout + refused.stderr
    assert passed.returncode == ExitCode.OK, passed.stdout + passed.stderr
