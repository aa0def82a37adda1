"""Clients without zensim code, and remote hosts."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.integration.processes import eventually, running, running_agents, serving, zensim

EXAMPLE = Path(__file__).parents[2] / "examples" / "plain_zenoh.py"


def test_plain_zenoh_program_drives_and_reads_robots() -> None:
    with serving() as server:
        server.zensim("fleet", "box_bot", "--robots", "4", "--spacing", "2")
        with running_agents(server, "box_bot2", "box_bot3"):
            done = subprocess.run(
                [sys.executable, str(EXAMPLE), server.endpoint, "box_bot3"],
                capture_output=True,
                text=True,
                timeout=120,
                check=True,
            )

    places = dict(line.split(": x=") for line in done.stdout.splitlines() if ": x=" in line)
    assert set(places) == {"box_bot2/odom", "box_bot3/odom"}
    assert float(places["box_bot2/odom"].split()[0]) == pytest.approx(4.0, abs=0.01)
    assert float(places["box_bot3/odom"].split()[0]) > 6.3


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@contextmanager
def two_hosts() -> Iterator[tuple[list[str], list[str], str]]:
    """Make two linked network namespaces; return their command prefixes and the first address."""
    tag = f"zs{os.getpid()}"
    run_in_process, there = f"{tag}a", f"{tag}b"
    with ExitStack() as stack:
        for name in (run_in_process, there):
            _ip("netns", "add", name)
            stack.callback(_ip, "netns", "del", name)
        _ip(
            "link",
            "add",
            run_in_process,
            "netns",
            run_in_process,
            "type",
            "veth",
            "peer",
            there,
            "netns",
            there,
        )
        for name, address in ((run_in_process, "10.87.0.1/24"), (there, "10.87.0.2/24")):
            _ip("-n", name, "addr", "add", address, "dev", name)
            _ip("-n", name, "link", "set", name, "up")
            _ip("-n", name, "link", "set", "lo", "up")
        prefixes = [["ip", "netns", "exec", name] for name in (run_in_process, there)]
        yield prefixes[0], prefixes[1], "10.87.0.1"


@pytest.mark.root
def test_robot_is_driven_from_a_remote_host() -> None:
    with two_hosts() as (here, there, address):
        endpoint = f"tcp/{address}:7447"
        with running("serve", "--insecure", "--listen", endpoint, prefix=here):
            connected = ("--connect", endpoint)
            assert_drivable(connected, connected, there)


@pytest.mark.root
def test_robot_is_driven_from_a_remote_host_by_tokens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with two_hosts() as (here, there, address):
        listen = ("--listen", f"tls/{address}:7447", "--json")
        with running("serve", "--secure", *listen, prefix=here) as server:
            assert server.stdout is not None
            facts = json.loads(server.stdout.readline())
            tokens = json.loads(Path(facts["tokens_file"]).read_text(encoding="utf-8"))
            made = zensim("token", "create", "--role", "agent", "--robot", "r1", prefix=here)
            agent = ("--join", made.stdout.strip())

            assert_drivable(("--join", tokens["operator"]), agent, there)


def assert_drivable(
    operator: tuple[str, ...], agent: tuple[str, ...], there: Sequence[str]
) -> None:
    spawned = zensim("spawn", "box_bot", "-n", "r1", *operator, prefix=there)
    assert spawned.returncode == 0, spawned.stderr
    with (
        running("agent", "r1", *agent, prefix=there),
        running("drive", "r1", "0.3", "0", *operator, prefix=there),
    ):

        def has_moved() -> bool:
            listed = zensim("list", "--json", *operator, prefix=there)
            return bool(json.loads(listed.stdout)[0]["x"] > 0.2)

        eventually(has_moved, 30.0, "moving")
