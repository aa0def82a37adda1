"""Driving

A peer commands 0.2 m/s for two seconds of simulation time, with Twist and with TwistStamped.
"""

from collections.abc import Iterator

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of, within
from tests.interop.foreign_peers import HUMBLE, JAZZY, list_routers, stage

MOVED_M = (0.36, 0.44)
ROBOT = "box_bot0"


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Drive through each router."""
    for router in list_routers(is_short=is_short):
        yield from measure_drive(router, JAZZY)


def measure_drive(router: str, distro: str) -> Iterator[Figure]:
    """Drive a robot with both types."""
    label = router if distro == JAZZY else f"{HUMBLE}, {router}"
    with stage(router, distro=distro) as network:
        network.spawn(1)
        with network.agents(ROBOT):
            network.wait_until_driven(1)
            for kind, options in (("Twist", ()), ("TwistStamped", ("--stamped",))):
                found = network.run("drive", "--robot", f"/{ROBOT}", *options)
                yield all_of(f"{label}: subscribers of {kind}", int(found["matched"]), 1)
                yield from within(f"{label}: way with {kind}", [found["moved_m"]], MOVED_M, "m")
