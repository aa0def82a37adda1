"""A separate router: programs start in any order, and reconnect after its restart."""

from tests.integration.processes import (
    START_S,
    Server,
    connected,
    eventually,
    free_endpoint,
    running,
    wait_for_agents,
    zensim,
)
from tests.integration.robots import robot, speed
from tests.integration.test_lifecycle import MOVING_M_S
from zensim.spawner.client.sim_client import SimClient

BACK_S = 20.0


def moves(server: Server, name: str) -> None:
    """Drive a robot until it moves, then until it stops."""
    driver = robot(server.bus, name)

    def is_moving() -> bool:
        driver.command(0.3)
        return speed(server, name) > MOVING_M_S

    eventually(is_moving, BACK_S, f"moving {name}")
    eventually(lambda: speed(server, name) < MOVING_M_S / 5, BACK_S, f"stopping {name}")


def test_router_may_start_last_and_may_restart() -> None:
    endpoint = free_endpoint()
    connect = ("--connect", endpoint)
    with running("agent", "r1", *connect), running("serve", *connect) as process:
        with running("router", "--listen", endpoint) as router, connected(endpoint) as bus:
            server = Server(process, endpoint, bus, SimClient(bus))
            server.client.wait_for_server(START_S)
            assert zensim("spawn", "box_bot", "--name", "r1", *connect).returncode == 0
            wait_for_agents(server, ["r1"])
            moves(server, "r1")
            steps = server.steps()
            router.kill()
            router.wait()
        with running("router", "--listen", endpoint), connected(endpoint) as bus:
            server = Server(process, endpoint, bus, SimClient(bus))
            server.client.wait_for_server(START_S)
            assert server.steps() > steps
            wait_for_agents(server, ["r1"])
            moves(server, "r1")
            process.kill()
            process.wait()
            with running("serve", *connect) as again:
                server = Server(again, endpoint, bus, SimClient(bus))
                server.client.wait_for_server(START_S)
                assert zensim("spawn", "box_bot", "--name", "r1", *connect).returncode == 0
                wait_for_agents(server, ["r1"])
                moves(server, "r1")


def test_router_prints_settings_that_another_router_takes() -> None:
    done = zensim("router", "--listen", "tcp/127.0.0.1:7999", "--print-config")

    assert done.returncode == 0
    assert '"mode":"router"' in done.stdout
    assert '"tcp/127.0.0.1:7999"' in done.stdout
