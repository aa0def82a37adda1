"""Late joiners

A peer subscribes to `/tf_static` after 150 robots are driven, with a queue of 100 messages as tf2
has, and to descriptions. It receives the root of each robot, and descriptions byte for byte.
"""

from collections.abc import Iterator

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of, at_most, naming, none_of
from tests.interop.foreign_peers import Stage, list_routers, stage
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import String
from zensim.proto.topic_catalog import ROBOT_DESCRIPTION

ROBOTS, ROBOTS_WHEN_SHORT = 150, 3
DEPTH = 100
DESCRIBED = 5
WAIT_S, COMPLETE_S, GET_S = 30.0, 2.0, 20.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Join late."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for router in list_routers(is_short=is_short):
        with stage(router, options=("--dynamics", "auto")) as network:
            names = network.spawn(robots)
            with network.agents("--pool", "0"):
                network.wait_until_driven(robots)
                yield from _judge(router, network, names)


def _judge(router: str, network: Stage, names: list[str]) -> Iterator[Figure]:
    described = {f"/{name}/{ROBOT_DESCRIPTION.suffix}": name for name in names[:DESCRIBED]}
    wanted = [word for topic in described for word in ("--description", topic)]
    limits = ("--roots", str(len(names)), "--depth", str(DEPTH), "--seconds", f"{WAIT_S:g}")
    found = network.run("late", *limits, *wanted)
    received = found["described"]
    different = [
        topic
        for topic, name in described.items()
        if topic not in received or received[topic][1] != _read_description(network, name)
    ]
    late_s = [ms * 1e-3 for ms, _ in received.values()] or [WAIT_S]
    messages = f"{router}: roots in {found['messages']} messages"
    yield all_of(messages, len(found["roots"]), len(names))
    yield Figure(what=f"{router}: roots arrive", unit="s", samples=(found["roots_ms"] * 1e-3,))
    yield none_of(naming(f"{router}: descriptions that differ", different), len(different))
    yield at_most(f"{router}: descriptions arrive", late_s, COMPLETE_S, "s", is_timed=True)


def _read_description(network: Stage, name: str) -> str:
    (sample,) = network.server.bus.get(ROBOT_DESCRIPTION.key(name), timeout_s=GET_S)
    return decode(String, sample.payload, sample.encoding).data
