"""Transforms of a fleet in several pools, as the AdvancedSubscriber of rmw_zenoh receives them."""

from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from tests.integration.processes import Server, eventually, running, serving, wait_for_agents
from tests.integration.rmw_sessions import TopicReader, open_rmw_session, subscribe_as_rmw
from tests.integration.ros_subscriptions import TF, key_of, publishers_of
from tests.proto.ros_oracle import HUMBLE
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped

ROBOTS = 150
"""More than the messages that tf2_ros keeps."""
ROW = 15
POOLS = 2
MESSAGES = 300
WITHIN_S = 60.0


def make_order(number: int) -> SpawnEntity:
    place = Point(x=float(number % ROW), y=float(number // ROW))
    return SpawnEntity(
        name=f"r{number}",
        entity_resource=Resource(uri="box_bot"),
        entity_namespace=f"r{number}",
        initial_pose=PoseStamped(pose=Pose(position=place)),
    )


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0", "--engine", "mujoco") as found:
        orders = [make_order(number) for number in range(ROBOTS)]
        found.client.spawn_all(SpawnEntitiesOrder(tuple(orders)))
        pool = ("agent", "--pool", "0", "--connect", found.endpoint)
        with running(*pool), running(*pool):
            wait_for_agents(found, [order.name for order in orders])
            yield found


@pytest.fixture
def session(server: Server) -> Iterator[zenoh.Session]:
    with open_rmw_session(server.endpoint) as found:
        yield found


def key_on_root(session: zenoh.Session, topic: str) -> str:
    def find() -> list[str] | None:
        tokens = publishers_of(session, topic)
        return tokens if len(tokens) >= POOLS else None

    return key_of(eventually(find, WITHIN_S, topic)[0])


def list_frames(reader: TopicReader, parent: str) -> set[str]:
    messages: list[Any] = [
        HUMBLE.deserialize_cdr(sample.payload.to_bytes(), TF) for sample in reader.queued()
    ]
    return {
        str(edge.child_frame_id)
        for message in messages
        for edge in message.transforms
        if edge.header.frame_id == parent
    }


def test_late_subscriber_has_the_roots_of_all_robots_in_the_queue_of_tf2(
    session: zenoh.Session,
) -> None:
    key = key_on_root(session, "/tf_static")

    reader, subscriber = subscribe_as_rmw(session, key, is_transient_local=True)

    wanted = {f"r{number}/odom" for number in range(ROBOTS)}
    eventually(lambda: list_frames(reader, "world") == wanted, WITHIN_S, "all roots")
    # A node that was busy while the messages came has the newest of them only.
    assert len(reader.samples) <= reader.depth
    assert len(reader.samples) < ROBOTS / 10
    subscriber.undeclare()


def test_subscriber_of_rmw_loses_no_transform_of_several_publishers(session: zenoh.Session) -> None:
    key = key_on_root(session, "/tf")
    every: list[bytes] = []
    plain = session.declare_subscriber(key, lambda one: every.append(identify(one)))
    reader, subscriber = subscribe_as_rmw(session, key)

    eventually(lambda: len(every) >= MESSAGES, WITHIN_S, "transforms")
    plain.undeclare()
    wanted = set(every)
    eventually(lambda: len(reader.samples) >= len(wanted), WITHIN_S, "the same transforms")

    received = {identify(sample) for sample in reader.samples}
    assert wanted <= received
    publishers = {sample.timestamp.get_id() for sample in reader.samples if sample.timestamp}
    assert len(publishers) == POOLS
    subscriber.undeclare()


def identify(sample: zenoh.Sample) -> bytes:
    """Identify a message by its attachment: number, time and publisher."""
    assert sample.attachment is not None
    return sample.attachment.to_bytes()
