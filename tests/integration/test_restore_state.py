"""A server that restores its journal says so, and handles what it received meanwhile."""

from pathlib import Path

from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import START_S, connected, eventually, free_endpoint, running
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.telemetry_messages import Info
from zensim.spawner.client.sim_client import SimClient

ROBOTS = 1500
"""Enough that a restore takes longer than a call."""


def test_state_is_answered_during_a_restore_and_other_requests_wait(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path, endpoint) as server:
        done = server.zensim("fleet", "box_bot", "--robots", str(ROBOTS), "--layout", "grid")
        assert done.returncode == 0, done.stderr
        kill_hard(server)

    with (
        running("serve", "--listen", endpoint, "--journal", str(tmp_path)) as process,
        connected(endpoint, process) as bus,
    ):
        client = SimClient(bus, timeout_s=START_S)

        def first_info() -> Info | None:
            try:
                return client.info()
            except (NoServer, TimeoutError):
                return None

        first = eventually(first_info, START_S, "a reply")
        names = client.entities()
        last = client.wait_for_server(START_S)

    assert (first.state, first.to_restore) == ("restoring", ROBOTS)
    assert 0 <= first.restored <= ROBOTS
    assert len(names) == ROBOTS
    assert (last.state, last.entities, last.restored) == ("playing", ROBOTS, 0)
