"""Receives what a ROS 2 node would: endpoints, topics and late copies of latched topics."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from http.client import HTTPException
from urllib.request import Request, urlopen

import msgspec

from zensim.deploy.cli.ros_requirements import PUBLISHER, RobotTopics
from zensim.proto.bus.bus_session import Bus, BusSubscription, open_bus
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.standard_messages import Clock, LaserScan, Odometry, String, TFMessage
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.liveliness_tokens import (
    NODE_KIND,
    TOKEN_SPACE,
    AnnouncedEndpoint,
    parse_endpoint_token,
)
from zensim.proto.ros2.rmw_keys import ANY_HASH, demangle_name, make_data_key, mangle_name
from zensim.proto.topic_catalog import CLOCK, TF, TF_STATIC
from zensim.proto.topic_endpoints import CACHE_SUFFIX
from zensim.spawner.spawn.description_xml import DescriptionError, parse_description
from zensim.spawner.spawn.search_paths import FILE_SCHEME, PACKAGE_SCHEMES, collect_search_paths

SHARED_TOPICS = (CLOCK.suffix, TF.suffix, TF_STATIC.suffix)
ROS_KINDS: dict[str, type[msgspec.Struct]] = {
    Clock.ros_type: Clock,
    LaserScan.ros_type: LaserScan,
    Odometry.ros_type: Odometry,
    String.ros_type: String,
    TFMessage.ros_type: TFMessage,
}
"""Types that the checks read."""
MIN_OBSERVED_S, MAX_OBSERVED_S = 1.0, 5.0
"""Wall time of observation: at least, and at most, while a topic has too few messages."""
MIN_MESSAGES = 3
POLL_S = 0.02
QUEUE_DEPTH = 4096
REPLY_TIMEOUT_S = 2.0
HTTP_TIMEOUT_S = 2.0
PEERS_WITHIN_S = 3.0
"""Time for a peer to find the others."""


def observe_robot(
    bus: Bus, domain: int, entity: EntityModel, models: GetModelsResponse
) -> RobotTopics:
    """Receive topics of a robot for one to five seconds of wall time.

    Args:
        bus: Open session.
        domain: ROS domain id.
        entity: The robot.
        models: With the model of the robot.
    """
    namespace = entity.namespace or entity.entity
    endpoints = tuple(_list_endpoints(bus, domain, namespace))
    messages = _receive_messages(bus, domain, endpoints)
    drive = models.models[entity.model].drive
    texts = [
        one.data
        for received in messages.values()
        for one in received
        if isinstance(one, String) and one.data
    ]
    links, meshes = read_description(texts[-1]) if texts else ((), ())
    return RobotTopics(
        namespace=namespace,
        endpoints=endpoints,
        messages=messages,
        publishes_odom_tf=drive is not None and drive.publish_odom_tf,
        links=links,
        meshes={uri: find_mesh_fault(uri) for uri in meshes},
        unreachable=list_unreachable_nodes(bus, domain),
    )


def list_unreachable_nodes(bus: Bus, domain: int) -> tuple[str, ...]:
    """List the ROS 2 nodes that those of this host cannot reach, although a router has both.

    Processes of rmw_zenoh are peers that listen on their own host, and no router passes on what
    peers exchange. A client gets the tokens of all, a peer those that it reaches.
    """
    if bus.user:
        return ()  # nodes of a secured server are clients
    pattern = f"{TOKEN_SPACE}/{domain}/*/*/*/{NODE_KIND}/**"
    every = set(bus.list_tokens(pattern))
    beside = msgspec.structs.replace(bus.config, mode="peer")
    deadline_s = time.monotonic() + PEERS_WITHIN_S
    with open_bus(beside) as peer:
        while missing := every.difference(peer.list_tokens(pattern)):
            if time.monotonic() > deadline_s:
                break
            time.sleep(POLL_S)
    return tuple(sorted(_read_node_name(token) for token in missing))


def _read_node_name(token: str) -> str:
    namespace, name = token.split("/")[-2:]
    return f"{demangle_name(namespace).rstrip('/')}/{demangle_name(name)}"


def read_description(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Read the names of the links and the URIs of the meshes of a URDF; none if it is not one."""
    try:
        root = parse_description(text)
    except DescriptionError:
        return (), ()
    links = tuple(one.get("name", "") for one in root.iter("link"))
    uris = (one.get("filename") or one.findtext("uri") or "" for one in root.iter("mesh"))
    return links, tuple(dict.fromkeys(uri.strip() for uri in uris if uri.strip()))


def find_mesh_fault(uri: str) -> str:
    """Find why RViz on this host would not find a mesh; empty if it would."""
    if uri.startswith(("http://", "https://")):
        return _find_http_fault(uri)
    if uri.startswith(FILE_SCHEME):
        return "" if os.path.isfile(uri.removeprefix(FILE_SCHEME)) else "no such file"  # noqa: PTH113
    if not uri.startswith(PACKAGE_SCHEMES):
        return "it is neither package:// nor file://"
    return collect_search_paths((), os.environ).find(uri).reason


def _find_http_fault(url: str) -> str:
    try:
        with urlopen(Request(url, method="HEAD"), timeout=HTTP_TIMEOUT_S):
            return ""
    except (OSError, ValueError, HTTPException) as error:
        return f"it is not served: {error}"


def _list_endpoints(bus: Bus, domain: int, namespace: str) -> Iterator[AnnouncedEndpoint]:
    """List the endpoints of topics of the robot, and of the shared topics."""
    own = f"{mangle_name(f'/{namespace}/')}$*"
    for name in (own, *(mangle_name(f"/{topic}") for topic in SHARED_TOPICS)):
        for token in bus.list_tokens(f"{TOKEN_SPACE}/{domain}/*/*/*/*/*/*/*/{name}/**"):
            if (found := parse_endpoint_token(token)) is not None:
                yield found


def _receive_messages(
    bus: Bus, domain: int, endpoints: Sequence[AnnouncedEndpoint]
) -> dict[str, list[msgspec.Struct]]:
    received: dict[str, list[msgspec.Struct]] = {}
    with ExitStack() as stack:
        subscriptions: dict[str, tuple[str, BusSubscription]] = {}
        for one in endpoints:
            if one.kind != PUBLISHER or one.ros_type not in ROS_KINDS or one.key in received:
                continue
            key = make_data_key(domain, one.key, one.ros_type, ANY_HASH)
            received[one.key] = []
            if one.qos.durability == "transient_local":
                late = bus.get_all(f"{key}/{CACHE_SUFFIX}/**", REPLY_TIMEOUT_S)
                received[one.key] += _decode_all(one.ros_type, late)
            else:
                subscription = stack.enter_context(closing(bus.subscribe(key, QUEUE_DEPTH)))
                subscriptions[one.key] = (one.ros_type, subscription)
        began_s = time.monotonic()
        while not _is_enough(began_s, [received[key] for key in subscriptions]):
            time.sleep(POLL_S)
            for topic, (ros_type, subscription) in subscriptions.items():
                received[topic] += _decode_all(ros_type, subscription.take())
    return received


def _is_enough(began_s: float, received: Sequence[Sequence[msgspec.Struct]]) -> bool:
    observed_s = time.monotonic() - began_s
    if observed_s < MIN_OBSERVED_S:
        return False
    return observed_s >= MAX_OBSERVED_S or all(len(one) >= MIN_MESSAGES for one in received)


def _decode_all(ros_type: str, samples: Sequence[Sample]) -> list[msgspec.Struct]:
    """Decode messages; what is not of the type is left out, as ROS 2 does."""
    found: list[msgspec.Struct] = []
    for sample in samples:
        with suppress(MalformedPayload):
            found.append(decode(ROS_KINDS[ros_type], sample.payload))
    return found
