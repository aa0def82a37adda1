"""Odometry of ten robots

A peer subscribes to the odometry of ten robots, as ROS 2 does, and beside that with a plain
subscriber. The sequence numbers in the attachments have no gap, and nothing that the plain one
received is missing in the other.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of, naming, none_of
from tests.interop.foreign_peers import HUMBLE, JAZZY, Stage, list_routers, stage

ROBOTS, ROBOTS_WHEN_SHORT = 10, 3
LISTEN_S, LISTEN_WHEN_SHORT_S = 30.0, 4.0
SHARE = 0.999


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Count messages through each router."""
    for router in list_routers(is_short=is_short):
        yield from measure_odom(router, JAZZY, is_short=is_short)


def measure_odom(router: str, distro: str, *, is_short: bool) -> Iterator[Figure]:
    """Count messages of robots that one pool drives."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    seconds = LISTEN_WHEN_SHORT_S if is_short else LISTEN_S
    with stage(router, distro=distro) as network:
        names = network.spawn(robots)
        with network.agents("--pool", "0"):
            network.wait_until_driven(robots)
            topics = listen(network, "--odom", [f"/{name}/odom" for name in names], seconds)
    label = router if distro == JAZZY else f"{HUMBLE}, {router}"
    yield from judge_topics(label, topics)


def listen(network: Stage, option: str, names: Sequence[str], seconds: float) -> dict[str, Any]:
    """Count the messages of topics for some time [s]."""
    wanted = [word for name in names for word in (option, name)]
    found = network.run("listen", *wanted, "--seconds", f"{seconds:g}", within_s=seconds)
    topics: dict[str, Any] = found["topics"]
    return topics


def judge_topics(label: str, topics: dict[str, Any]) -> Iterator[Figure]:
    """Compare what the two subscribers received."""
    total = {name: sum(one[name] for one in topics.values()) for name in COUNTS}
    silent = sorted(name for name, one in topics.items() if not one["advanced"])
    share = 1.0 - total["missing"] / max(1, total["plain"])
    yield none_of(naming(f"{label}: topics without a message", silent), len(silent))
    yield all_of(f"{label}: share of {total['plain']} messages received", share, SHARE)
    for name in ("gaps", "without_attachment", "undecodable"):
        yield none_of(f"{label}: {COUNTS[name]}", total[name])


COUNTS = {
    "plain": "messages of the plain subscriber",
    "advanced": "messages",
    "missing": "messages that only the plain subscriber received",
    "gaps": "gaps in sequence numbers",
    "without_attachment": "messages without attachment",
    "undecodable": "undecodable messages",
}
"""What a peer counts."""
