"""Humble

Peers of humble, whose keys have no type hashes, and `--ros-distro humble`: odometry, driving,
spawning.
"""

from collections.abc import Iterator

from benchmarks.figures import Figure
from tests.interop.foreign_peers import HUMBLE, list_routers
from tests.interop.interop_drive import measure_drive
from tests.interop.interop_odom import measure_odom
from tests.interop.interop_spawn import measure_spawn

VERSIONS = {"1.x": ("--v1",)}
"""Without a hash, two versions of a service would have one key."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Repeat three figures with the other distribution."""
    for router in list_routers(is_short=is_short):
        yield from measure_odom(router, HUMBLE, is_short=is_short)
        yield from measure_drive(router, HUMBLE)
        yield from measure_spawn(router, HUMBLE, VERSIONS, is_short=is_short)
