"""A server uses the requested engine, or an installed one by default."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.processes import (
    Server,
    free_endpoint,
    running_agents,
    serving,
    without_libraries,
    zensim,
)
from tests.integration.robots import drive_for, robot
from zensim.proto.exit_codes import ExitCode

TWO = ("box_bot0", "box_bot1")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with default options where PyBullet is not installed."""
    with serving(prefix=without_libraries(tmp_path_factory.mktemp("bare"), "pybullet")) as found:
        yield found


def test_server_uses_mujoco_when_pybullet_is_not_installed(server: Server) -> None:
    assert server.client.info().engine == "mujoco"
    assert "on mujoco" in server.zensim("doctor").stdout


def test_robots_follow_their_commands_on_mujoco(server: Server) -> None:
    spawned = server.zensim("fleet", "box_bot", "--robots", "2", "--spacing", "2")
    assert spawned.returncode == 0, spawned.stderr

    with running_agents(server, *TWO):
        robots = [robot(server.bus, name) for name in TWO]
        ahead = drive_for(server.client, robots, linear=0.2, angular=0.0, sim_s=5.0)
        turned = drive_for(server.client, robots, linear=0.0, angular=1.0, sim_s=5.0)

    assert [drive_result.forward_m for drive_result in ahead] == pytest.approx([1.0] * 2, rel=0.01)
    assert [drive_result.sideways_m for drive_result in ahead] == pytest.approx([0.0] * 2, abs=0.01)
    assert [drive_result.turned_rad for drive_result in turned] == pytest.approx(
        [5.0] * 2, rel=0.02
    )


@pytest.mark.parametrize(("engine", "other"), [("pybullet", "mujoco"), ("mujoco", "pybullet")])
def test_server_names_installed_engines_when_its_engine_is_missing(
    engine: str, other: str, tmp_path: Path
) -> None:
    request = ("serve", "--engine", engine, "--listen", free_endpoint())

    done = zensim(*request, prefix=without_libraries(tmp_path, engine))

    assert done.returncode == ExitCode.USAGE
    (line,) = done.stderr.splitlines()
    assert engine in line
    assert f"--engine {other}" in line


def test_server_refuses_an_unknown_engine() -> None:
    done = zensim("serve", "--engine", "dart", "--listen", free_endpoint())

    assert done.returncode == ExitCode.USAGE
    assert all(name in done.stderr for name in ("'dart'", "pybullet", "mujoco"))


def test_server_uses_pybullet_when_both_are_installed() -> None:
    with serving() as found:
        assert found.client.info().engine == "pybullet"
