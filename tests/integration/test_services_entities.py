"""Entity services of simulation_interfaces on a real server, over the network."""

import json
from collections.abc import Iterator

import pytest

from tests.feature_checks import FEATURE_CHECKS
from tests.integration.processes import Server, agent_of, eventually, running_agents, serving
from tests.integration.robots import robot
from zensim.proto import keys
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.entity_messages import (
    Bounds,
    BoundsType,
    EntityFilters,
    EntityInfo,
    TagsFilter,
)
from zensim.proto.messages.result_messages import (
    ResultCode,
    ServiceError,
    SpawnCode,
    SpawnEntitiesCode,
)
from zensim.proto.messages.simulation_messages import Feature, State
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import Header, Point, Pose, PoseStamped, Vector3
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.topic_catalog import EVENTS


@pytest.fixture(scope="module")
def running_server() -> Iterator[Server]:
    with serving() as found:
        yield found


@pytest.fixture
def server(running_server: Server) -> Server:
    client = running_server.client
    client.load_world("empty")
    client.set_simulation_state(State.PLAYING)
    return running_server


def a_fleet(*names: str, info: EntityInfo | None = None) -> SpawnEntitiesOrder:
    requests = tuple(
        SpawnEntity(name, initial_pose=PoseStamped(pose=Pose(Point(float(i)))))
        for i, name in enumerate(names)
    )
    common = SpawnEntityOrder(entity_resource=Resource("box_bot"), snap_to_ground=True, info=info)
    return SpawnEntitiesOrder(requests, atomic=True, common=common)


def spawned_in(events: BusSubscription, found: list[Event]) -> list[Event]:
    received = [decode(Event, sample.payload, sample.encoding) for sample in events.take()]
    found.extend(event for event in received if event.kind == "spawned")
    return found


@pytest.mark.parametrize("feature", FEATURE_CHECKS, ids=lambda feature: feature.name)
def test_announced_feature_works_over_the_network(server: Server, feature: Feature) -> None:
    assert feature in server.client.features().features

    FEATURE_CHECKS[feature](server.client)


def test_batch_is_spawned_between_two_steps(server: Server) -> None:
    events, found = server.bus.subscribe(EVENTS.key("default"), 1000), list[Event]()
    names = [f"r{i}" for i in range(20)]

    response = server.client.spawn_all(a_fleet(*names))

    assert [one.entity_name for one in response.results] == names
    eventually(lambda: len(spawned_in(events, found)) == len(names), 5.0, "events")
    assert len({event.step for event in found}) == 1


def test_batch_is_not_spawned_when_one_entity_fails(server: Server) -> None:
    server.client.spawn_all(a_fleet("r0"))

    response = server.client.spawn_all(a_fleet("a", "r0", "b"))

    assert response.result.result == SpawnEntitiesCode.ENTITIES_SPAWN_FAILED
    assert [one.result.result for one in response.results] == [4, SpawnCode.NAME_NOT_UNIQUE, 4]
    assert server.client.entities() == ("r0",)


def test_filters_are_applied_together(server: Server) -> None:
    client = server.client
    client.spawn_all(a_fleet(*(f"r{i}" for i in range(12)), info=EntityInfo(tags=("red",))))
    client.spawn_all(a_fleet("x1"))
    ball = Bounds(BoundsType.SPHERE, (Vector3(10.0), Vector3(2.5)))

    found = client.entities(EntityFilters("1$", tags=TagsFilter(("red",)), bounds=ball))

    assert found == ("r11",)
    assert set(client.entity_states(EntityFilters("^r1"))) == {"r1", "r10", "r11"}


@pytest.mark.parametrize("pattern", ["^(a+)+$", "|".join(f"a{{{i}}}b" for i in range(100))])
def test_stepping_continues_under_a_hostile_filter(server: Server, pattern: str) -> None:
    client = server.client
    client.spawn_all(a_fleet(*("a" * 60 + f"{i:03}" for i in range(50))))
    before = server.steps()

    assert found_or_given_up(server, pattern) == ()

    eventually(lambda: server.steps() > before, 5.0, "a step")


def found_or_given_up(server: Server, pattern: str) -> tuple[str, ...]:
    try:
        return server.client.entities(EntityFilters(pattern))
    except ServiceError as error:
        if "filter.time" not in error.message:
            raise
        return ()


def test_a_robot_is_spawned_in_the_frame_of_a_link_of_another(server: Server) -> None:
    client = server.client
    client.set_simulation_state(State.PAUSED)
    client.spawn_all(a_fleet("r0"))
    link = client.models(("r0",)).models[0].links[1].name
    pose = PoseStamped(Header(frame_id=f"r0::{link}"), Pose(Point(0.0, 0.0, 1.0)))

    client.spawn(SpawnEntityOrder("r1", entity_resource=Resource("box_bot"), initial_pose=pose))

    place = client.entity_state("r1", f"r0/{link}").pose.position
    assert (place.x, place.y, place.z) == pytest.approx((0.0, 0.0, 1.0))


def test_deleting_keeps_claims_and_poses_of_others(server: Server) -> None:
    client = server.client
    client.spawn_all(a_fleet("r0", "r1", "r2"))
    with running_agents(server, "r1"):
        odom = robot(server.bus, "r1")
        agent = agent_of(server, "r1")
        before = client.entity_state("r1").pose.position

        for _ in range(5):
            client.delete("r0")
            client.spawn_all(a_fleet("r0"))
        client.delete("r2")

        assert agent_of(server, "r1") == agent
        after = client.entity_state("r1").pose.position
        assert (after.x, after.y, after.z) == pytest.approx(
            (before.x, before.y, before.z), abs=1e-3
        )
        assert odom.now().child_frame_id


@pytest.mark.parametrize("spaces", [0, 5000])
def test_json_request_gets_a_json_reply(server: Server, spaces: int) -> None:
    server.client.spawn_all(a_fleet("r0", "r1"))
    request = {"filters": {"filter": "1$"}, "reference_frame": "r0"}

    (sample,) = server.bus.get(
        keys.service("default", "get_entities_states"),
        payload=json.dumps(request).encode() + b" " * spaces,
    )

    response = json.loads(sample.payload)
    assert response["entities"] == ["r1"]
    assert response["states"][0]["header"]["frame_id"] == "r0"
    assert response["states"][0]["pose"]["position"]["x"] == pytest.approx(1.0, abs=0.01)
    assert response["result"]["result"] == ResultCode.OK
