"""Accuracy

Ten box_bots drive at once for 10 simulated seconds and then stop. The motion is read from their
odometry, which a box_bot takes from the world and not from its wheels. A sample is a robot.
"""

from collections.abc import Iterator

from benchmarks.figures import Figure, table
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT, fleet
from tests.integration.robots import drive_for

__all__ = ["rows", "table"]

SIM_S = 10.0
SPEED = 0.2
TURN = 1.0
MILLIMETRES = 1e3


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure straight driving and turning on the spot."""
    sim_s = 1.0 if is_short else SIM_S
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        straight = drive_for(
            found.server.client, found.robots, linear=SPEED, angular=0.0, sim_s=sim_s
        )
        turned = drive_for(found.server.client, found.robots, linear=0.0, angular=TURN, sim_s=sim_s)
    way_m, turn_rad = SPEED * sim_s, TURN * sim_s
    yield Figure(
        what=f"{SPEED:g} m/s for {sim_s:g} s: off {way_m:g} m",
        unit="%",
        samples=tuple(abs(course.forward_m / way_m - 1.0) * 100.0 for course in straight),
    )
    yield Figure(
        what=f"{SPEED:g} m/s for {sim_s:g} s: sideways",
        unit="mm",
        samples=tuple(abs(course.sideways_m) * MILLIMETRES for course in straight),
    )
    yield Figure(
        what=f"{TURN:g} rad/s for {sim_s:g} s: off {turn_rad:g} rad",
        unit="%",
        samples=tuple(abs(course.turned_rad / turn_rad - 1.0) * 100.0 for course in turned),
    )
