"""Finds other publishers on the keys of a replay."""

from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from zensim.proto import keys
from zensim.proto.ros2.liveliness_tokens import TOKEN_SPACE, parse_endpoint_token
from zensim.proto.topic_catalog import TOPICS
from zensim.spawner.client.service_client import ServiceClient

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

PUBLISHER: Final = "MP"
ROOT_KEYS: Final = frozenset(one.suffix for one in TOPICS.values() if one.root_message is not None)
"""`/clock`, `/tf` and others, which every world publishes."""
WORLD_TIMEOUT_S: Final = 2.0


class TopicsInUse(ValueError):
    """There are other publishers on keys of a replay."""

    def __init__(self, users: Iterable[str]) -> None:
        listed = list(users)
        shown = ", ".join(listed[:MAX_SHOWN])
        more = f" and {len(listed) - MAX_SHOWN} more" if len(listed) > MAX_SHOWN else ""
        super().__init__(
            f"{shown}{more}; use --namespace replay for other names, --topics for others, or "
            "--force to publish there, too"
        )


MAX_SHOWN: Final = 3


def require_unused(network: "Bus", wanted: Collection[str], world: str, domain: int | None) -> None:
    """Check that there is no other publisher on keys.

    Args:
        network: Session.
        wanted: Keys of a replay.
        world: Name of the world whose clock the replay publishes.
        domain: Of ROS 2; None = only plain keys.

    Raises:
        TopicsInUse: A running world, another replay or a ROS 2 node publishes on one of them.
    """
    users = dict.fromkeys(
        (
            *_list_worlds(network, wanted, world),
            *_list_replays(network, world),
            *_list_nodes(network, wanted, domain),
        )
    )
    if users:
        raise TopicsInUse(users)


def _list_worlds(network: "Bus", wanted: Collection[str], world: str) -> Iterator[str]:
    """List what running worlds publish: namespaces of robots, and keys of the root."""
    for name in network.list_worlds():
        models = ServiceClient(network, name, WORLD_TIMEOUT_S).models()
        namespaces = {one.namespace.strip("/") for one in models.entities}
        for namespace in _find_namespaces(wanted, namespaces):
            yield f"namespace '{namespace}' is of a living robot of world '{name}'"
        if name == world and any(key.startswith(f"sim/{world}/") for key in wanted):
            yield f"world '{name}' is running"
        elif any(key in ROOT_KEYS for key in wanted):
            yield f"'/clock' is of world '{name}', which is running"


def _find_namespaces(wanted: Collection[str], namespaces: Collection[str]) -> list[str]:
    """Find the namespaces that are the start of a key."""
    starts = {key[:at] for key in wanted for at, letter in enumerate(key) if letter == "/"}
    return sorted(starts & set(namespaces))


def _list_replays(network: "Bus", world: str) -> Iterator[str]:
    if network.list_tokens(keys.alive_replay(world)):
        yield f"world '{world}' is replayed already"


def _list_nodes(network: "Bus", wanted: Collection[str], domain: int | None) -> Iterator[str]:
    """List topics that ROS 2 nodes publish."""
    if domain is None:
        return
    found = set(wanted)
    for token in network.list_tokens(f"{TOKEN_SPACE}/{domain}/**"):
        endpoint = parse_endpoint_token(token)
        if endpoint is not None and endpoint.kind == PUBLISHER and endpoint.key in found:
            yield f"topic '/{endpoint.key}' is published by node '{endpoint.node}'"
