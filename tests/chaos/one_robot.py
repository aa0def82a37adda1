"""A server with one robot, which agents drive until something happens to them."""

from collections.abc import Iterator
from contextlib import contextmanager

from tests.integration.processes import Server, eventually, serving
from tests.integration.robots import Robot

ROBOT = "r1"
MOVING_M_S, STANDING_M_S = 0.1, 0.01


@contextmanager
def serve_one_robot() -> Iterator[Server]:
    """Run a server with a box_bot."""
    with serving() as server:
        server.zensim("spawn", "box_bot", "--name", ROBOT)
        yield server


def find_speed(server: Server) -> float:
    """Get the planar speed of the robot [m/s]."""
    linear = server.client.entity_state(ROBOT).twist.linear
    return float((linear.x**2 + linear.y**2) ** 0.5)


def drive_until_moving(server: Server, driver: Robot, further_s: float = 0.0) -> None:
    """Command the robot until it moves, and for a simulated time more [s]."""

    def is_moving() -> bool:
        driver.command(0.3, 0.5)
        return find_speed(server) > MOVING_M_S

    eventually(is_moving, 20.0, "moving")
    until_s = server.client.info().sim_time_s + further_s
    while server.client.info().sim_time_s < until_s:
        driver.command(0.3, 0.5)
