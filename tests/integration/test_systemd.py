"""The unit `zensim@.service`, run by a systemd: ready, robots, stop, crash, watchdog, mistakes."""

import json
from collections.abc import Iterator

import pytest

from tests.contract.repository import ROOT, text_of
from tests.integration.processes import eventually
from tests.integration.systemd_host import UNITS, SystemdHost, systemd_host
from zensim.proto.exit_codes import ExitCode

pytestmark = pytest.mark.root

UNIT = ROOT / "deploy" / "systemd" / "zensim@.service"
WORLD = "warehouse"
SERVICE, POOL = f"zensim@{WORLD}", f"zensim-pool@{WORLD}"
SETTINGS = "serve:\n  world: empty\n  engine: mujoco\n  ros-domain: off\n"
POOL_COMMAND = "/opt/zensim/bin/zensim agent --pool 0 --connect tcp/127.0.0.1:7447"
ROBOTS = 10
WITHIN_S = 60.0
FIRST_DYNAMIC_USER = 61184
SHORT_WATCHDOG = "[Service]\nWatchdogSec=2\nTimeoutAbortSec=1\n"


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SystemdHost]:
    folder = tmp_path_factory.mktemp("systemd")
    pool = folder / "zensim-pool@.service"
    lines = text_of(UNIT).splitlines()
    pool.write_text("\n".join(map(_change_command, lines)) + "\n")
    with systemd_host(tmp_path_factory.mktemp("host"), UNIT, pool) as found:
        found.write(f"/etc/zensim/{WORLD}.yaml", SETTINGS)
        yield found


def _change_command(line: str) -> str:
    return f"ExecStart={POOL_COMMAND} --world-name %i" if line.startswith("ExecStart=") else line


@pytest.fixture
def server(host: SystemdHost) -> Iterator[SystemdHost]:
    """Start the server; its world is that of the tests before."""
    done = host.run("systemctl", "start", SERVICE)
    assert done.returncode == 0, done.stderr
    yield host
    host.run("systemctl", "stop", SERVICE)


def list_agents(host: SystemdHost) -> list[str]:
    """List the agents of all robots, empty where there is none."""
    done = host.zensim("list", "--json", "--world-name", WORLD)
    assert done.returncode == ExitCode.OK, done.stderr
    return [str(one["agent"]) for one in json.loads(done.stdout)]


def spawn_missing(host: SystemdHost) -> None:
    if not list_agents(host):
        words = ("fleet", "box_bot", "--robots", str(ROBOTS), "--world-name", WORLD)
        done = host.zensim(*words)
        assert done.returncode == ExitCode.OK, done.stderr


def await_restart(host: SystemdHost, restarts: int) -> None:
    def is_again_active() -> bool:
        found = host.show(SERVICE)
        return int(found["NRestarts"]) > restarts and found["ActiveState"] == "active"

    eventually(is_again_active, WITHIN_S, "a restart")


def test_server_is_ready_spawns_robots_and_stops(server: SystemdHost) -> None:
    found = server.show(SERVICE)
    user = server.run("stat", "-c", "%u", f"/proc/{found['MainPID']}").stdout
    spawn_missing(server)
    robots = len(list_agents(server))

    done = server.run("systemctl", "stop", SERVICE)

    ended = server.show(SERVICE)
    assert (found["ActiveState"], found["StatusErrno"]) == ("active", "0")
    assert int(user) >= FIRST_DYNAMIC_USER
    assert robots == ROBOTS
    assert done.returncode == 0
    assert (ended["ActiveState"], ended["Result"]) == ("inactive", "success")
    assert (ended["ExecMainStatus"], ended["NRestarts"]) == (str(int(ExitCode.OK)), "0")


@pytest.mark.long_form
def test_pool_by_a_copy_of_the_unit_drives_the_robots(server: SystemdHost) -> None:
    spawn_missing(server)

    done = server.run("systemctl", "start", POOL)

    assert done.returncode == 0, done.stderr
    eventually(lambda: all(list_agents(server)), WITHIN_S, "claims")
    assert server.run("systemctl", "stop", POOL).returncode == 0
    assert server.show(POOL)["Result"] == "success"


def test_killed_server_is_started_again_with_its_robots(server: SystemdHost) -> None:
    spawn_missing(server)
    before = server.show(SERVICE)

    server.run("kill", "-KILL", before["MainPID"])

    await_restart(server, int(before["NRestarts"]))
    assert len(list_agents(server)) == ROBOTS


@pytest.mark.long_form
def test_stuck_server_is_ended_by_the_watchdog_and_started_again(server: SystemdHost) -> None:
    spawn_missing(server)
    server.run("systemctl", "stop", SERVICE)
    server.run("mkdir", "-p", f"{UNITS}/zensim@.service.d")
    server.write(f"{UNITS}/zensim@.service.d/watchdog.conf", SHORT_WATCHDOG)
    server.run("systemctl", "daemon-reload")
    server.run("systemctl", "start", SERVICE)
    before = server.show(SERVICE)

    server.run("kill", "-STOP", before["MainPID"])

    await_restart(server, int(before["NRestarts"]))
    assert server.show(SERVICE)["MainPID"] != before["MainPID"]
    assert len(list_agents(server)) == ROBOTS


def test_mistake_in_the_settings_is_not_tried_again(host: SystemdHost) -> None:
    host.write("/etc/zensim/wrong.yaml", "serve:\n  no-such-option: 1\n")

    done = host.run("systemctl", "start", "zensim@wrong")

    found = host.show("zensim@wrong")
    assert done.returncode != 0
    assert found["ExecMainStatus"] == str(int(ExitCode.USAGE))
    assert (found["ActiveState"], found["NRestarts"]) == ("failed", "0")
