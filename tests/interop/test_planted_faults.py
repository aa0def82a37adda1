"""A fault that is planted turns exactly its figure red."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import pytest
import zenoh

from benchmarks.figures import Figure
from tests.integration.processes import connected, free_endpoint, running
from tests.integration.ros_client_process import session_of
from tests.interop.foreign_peers import JAZZY, PeerNetwork, Stage, stage
from tests.interop.interop_graph import judge_graph, read_graph
from tests.interop.interop_odom import judge_topics, listen
from tests.interop.interop_spawn import judge_spawns
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode
from zensim.proto.messages.result_messages import Result, ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import DeleteEntityResponse, SpawnEntityResponse
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.ros_service_catalog import ROS_SERVICES, RosService
from zensim.proto.ros2.type_hash import hash_type

pytestmark = pytest.mark.interop
TOPIC = "/planted/odom"
GID = bytes(range(16))
EVERY_S = 0.02
LISTEN_S = 2.0
CALLS = 4
NO_RESULT = ["Result for unknown URI", "Result for malformed bytes"]


def missed(rows: Iterable[Figure]) -> list[str]:
    """List the missed figures, without label."""
    return [row.what.partition(": ")[2] for row in rows if row.is_missed]


@pytest.fixture(scope="module")
def network() -> Iterator[Stage]:
    with stage() as found:
        yield found


@contextmanager
def publishing(session: zenoh.Session, *, is_attached: bool) -> Iterator[None]:
    """Publish odometry, with or without attachments."""
    key = make_data_key(0, TOPIC, Odometry.ros_type, hash_type(Odometry))
    payload, stop = encode(Odometry(), Format.CDR), threading.Event()

    def publish() -> None:
        number = 0
        while not stop.wait(EVERY_S):
            number += 1
            attachment = write_attachment(Attachment(number, time.time_ns(), GID))
            session.put(key, payload, attachment=attachment if is_attached else None)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    ("is_attached", "red"), [(True, []), (False, ["messages without attachment"])]
)
def test_odometry_without_attachments(network: Stage, *, is_attached: bool, red: list[str]) -> None:
    with session_of(network) as session, publishing(session, is_attached=is_attached):
        topics = listen(network, "--odom", [TOPIC], LISTEN_S)

    assert missed(judge_topics("planted", topics)) == red


@pytest.mark.parametrize("is_right", [True, False])
def test_topic_with_a_wrong_hash(network: Stage, *, is_right: bool) -> None:
    type_hash = hash_type(Odometry) if is_right else f"RIHS01_{'0' * 64}"
    with session_of(network) as session:
        ids, node = f"@ros2_lv/0/{session.info.zid()}/0", "%/%/planted"
        dds = "nav_msgs::msg::dds_::Odometry_"
        tokens = [
            session.liveliness().declare_token(token)
            for token in (
                f"{ids}/0/NN/{node}",
                f"{ids}/1/MP/{node}/%planted%odom/{dds}/{type_hash}/::,10:,:,:,,",
            )
        ]
        found = read_graph(network)
        for token in tokens:
            token.undeclare()

    red = [one.partition(":")[0] for one in missed(judge_graph("planted", [], found))]
    assert red == ([] if is_right else ["types with another hash"])


@pytest.fixture(scope="module")
def bare_network() -> Iterator[PeerNetwork]:
    """Run a router without a simulator."""
    endpoint = free_endpoint()
    with running("router", "--listen", endpoint) as router, connected(endpoint, router):
        yield PeerNetwork(endpoint, JAZZY)


@contextmanager
def serving_spawns(session: zenoh.Session, *, is_complete: bool) -> Iterator[None]:
    """Serve /spawn_entity and /delete_entity, with complete queryables or without."""
    wanted = ("simulation_interfaces/srv/SpawnEntity", "simulation_interfaces/srv/DeleteEntity")
    queryables = [
        session.declare_queryable(service.list_keys(0)[0], answering(service), complete=is_complete)
        for service in ROS_SERVICES
        if service.ros_type in wanted
    ]
    yield
    for queryable in queryables:
        queryable.undeclare()


def answering(service: RosService) -> Callable[[zenoh.Query], None]:
    """Make a callback that replies to requests."""

    def reply(query: zenoh.Query) -> None:
        assert query.attachment is not None
        assert query.payload is not None
        asked = read_attachment(query.attachment.to_bytes())
        assert asked is not None
        response = respond(service, query.payload.to_bytes())
        attachment = write_attachment(Attachment(asked.sequence_number, time.time_ns(), asked.gid))
        query.reply(query.key_expr, encode(response, Format.CDR), attachment=attachment)

    return reply


def respond(service: RosService, payload: bytes) -> SpawnEntityResponse | DeleteEntityResponse:
    try:
        request = service.decode_request(payload)
    except MalformedPayload:
        return SpawnEntityResponse(Result(ResultCode.INCORRECT_STATE))
    if service.ros_type.endswith("DeleteEntity"):
        return DeleteEntityResponse(Result(ResultCode.OK))
    if getattr(request, "entity_resource").uri != "box_bot":  # noqa: B009  of either version
        return SpawnEntityResponse(Result(SpawnCode.MISSING_ASSETS))
    return SpawnEntityResponse(Result(ResultCode.OK), getattr(request, "name"))  # noqa: B009


@pytest.mark.parametrize(("is_complete", "red"), [(True, []), (False, NO_RESULT)])
def test_service_with_an_incomplete_queryable(
    bare_network: PeerNetwork, *, is_complete: bool, red: list[str]
) -> None:
    with session_of(bare_network) as session, serving_spawns(session, is_complete=is_complete):
        found = bare_network.run("spawn", "--clients", "2", "--calls", str(CALLS))

    rows = [row for row in judge_spawns("planted", CALLS, found) if not row.limit.is_timed]  # type: ignore[union-attr]
    assert missed(rows) == red
