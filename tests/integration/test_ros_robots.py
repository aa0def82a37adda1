"""Robots listed, subscribed to and driven by an independent ROS 2 client.

With single agents and a pool, for distributions with type hashes and for humble without.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.integration import ros_interfaces as ros
from tests.integration.processes import (
    Server,
    eventually,
    running,
    running_agents,
    serving,
    wait_for_agents,
)
from tests.integration.ros_client_process import (
    CallObserver,
    result_of,
    ros_client,
    run_observer,
    session_of,
)
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    TF,
    TRANSIENT_LOCAL,
    TYPES,
    key_of,
    place_of,
    publishers_of,
    subscribe_transient_local,
)
from zensim.proto.messages.result_messages import ResultCode

ROBOTS = ("r1", "r2")
SPAWN = "simulation_interfaces/srv/SpawnEntity"
DELETE = "simulation_interfaces/srv/DeleteEntity"
GET_ENTITIES = "simulation_interfaces/srv/GetEntities"
AT_SIDE = {"pose": {"position": {"y": 5.0, "z": 0.06}, "orientation": {"w": 1.0}}}
HEARD = ("/r1/odom", "/r2/tf", "/tf", "/r1/joint_states", "/clock")


class Installation:
    """A server and its agents."""

    def __init__(self, agents: str, distribution: str) -> None:
        self.is_pooled = agents == "pool"
        self.options = ("--ros-distro", distribution)
        self.type_hash = ros.OF_HUMBLE if distribution == "humble" else ""

    def hash_of(self, published: str) -> str:
        """Find the type hash of a service."""
        return self.type_hash or published

    @contextmanager
    def driving(self, server: Server, *names: str) -> Iterator[None]:
        """Run agents for some robots; a pool claims all robots."""
        with ExitStack() as stack:
            if not self.is_pooled:
                stack.enter_context(running_agents(server, *names, options=self.options))
            wait_for_agents(server, names)
            yield


@pytest.fixture(
    scope="module",
    params=[
        ("each", "jazzy"),
        pytest.param(("each", "humble"), marks=pytest.mark.long_form),
        pytest.param(("pool", "jazzy"), marks=pytest.mark.long_form),
        ("pool", "humble"),
    ],
    ids="-".join,
)
def installation(request: pytest.FixtureRequest) -> Installation:
    return Installation(*request.param)


@pytest.fixture(scope="module")
def server(installation: Installation) -> Iterator[Server]:
    with ExitStack() as stack:
        found = stack.enter_context(serving("--ros-domain", "0", *installation.options))
        for name in ROBOTS:
            found.zensim("spawn", "box_bot", "-n", name, "-y", name[1:])
        if installation.is_pooled:
            joining = ("--connect", found.endpoint, *installation.options)
            stack.enter_context(running("agent", "--pool", "0", *joining))
        stack.enter_context(installation.driving(found, *ROBOTS))
        yield found


@pytest.fixture(scope="module")
def observe(server: Server, installation: Installation) -> Iterator[CallObserver]:
    with run_observer(server, 0, installation.type_hash) as found:
        yield found


def test_topics_are_listed_with_their_types(observe: CallObserver) -> None:
    def are_all_there() -> bool:
        return TYPES.keys() | {"/r2/cmd_vel"} <= set(observe("topics"))

    eventually(are_all_there, DISCOVERY_S, "tokens")
    listed = observe("topics")

    assert {topic: listed[topic] for topic in TYPES} == {k: [v] for k, v in TYPES.items()}
    assert listed["/r2/cmd_vel"] == ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"]


@pytest.mark.parametrize("topic", HEARD)
def test_messages_are_received(observe: CallObserver, topic: str) -> None:
    kind = TYPES[topic.replace("/r2/", "/r1/")]

    assert (
        len(observe("receive", topic=topic, kind=kind, count=3, within_s=DISCOVERY_S, qos="")) == 3
    )


def test_late_joiner_receives_the_static_transforms_of_all_robots(
    observe: CallObserver, installation: Installation
) -> None:
    given = {"kind": TF, "within_s": DISCOVERY_S, "qos": TRANSIENT_LOCAL}

    count = 1 if installation.is_pooled else 2
    shared = observe("receive", topic="/tf_static", count=count, **given)
    own = observe("receive", topic="/r2/tf_static", count=1, **given)

    parents = {edge["header"]["frame_id"] for one in shared for edge in one["transforms"]}
    assert {"r1/base_footprint", "r2/base_footprint"} <= parents
    assert own[0]["transforms"][0]["header"]["frame_id"] == "base_footprint"


@pytest.mark.parametrize("kind", ["Twist", "TwistStamped"])
def test_robot_is_driven_alone(observe: CallObserver, server: Server, kind: str) -> None:
    before, other = place_of(server, "r2"), place_of(server, "r1")
    twist = {"linear": {"x": 0.5}}
    fields = {"twist": twist} if kind == "TwistStamped" else twist

    def has_moved() -> bool:
        observe("publish", topic="/r2/cmd_vel", kind=f"geometry_msgs/msg/{kind}", fields=fields)
        return abs(place_of(server, "r2") - before) > 0.05

    eventually(has_moved, 20.0, f"driving by {kind}")
    assert place_of(server, "r1") == pytest.approx(other, abs=0.02)


def test_early_subscriber_receives_latched_messages(
    observe: CallObserver, server: Server, installation: Installation
) -> None:
    kinds = {"/r3/tf_static": TF, "/r3/robot_description": "std_msgs/msg/String"}
    for topic, kind in kinds.items():
        observe("subscribe", topic=topic, kind=kind, qos=TRANSIENT_LOCAL)
    samples: list[str] = []

    with session_of(server) as session:
        keys = [
            key_of(publishers_of(session, topic.replace("r3", "r1"))[0]).replace("/r1/", "/r3/")
            for topic in kinds
        ]
        joiners = [
            subscribe_transient_local(
                session, key, lambda sample: samples.append(str(sample.key_expr))
            )
            for key in keys
        ]
        server.zensim("spawn", "box_bot", "-n", "r3", "-y", "3")
        with installation.driving(server, "r3"):
            eventually(lambda: set(samples) == set(keys), DISCOVERY_S, "rmw's subscribers")
            eventually(
                lambda: all(observe("received", topic=one) for one in kinds),
                DISCOVERY_S,
                "the kit's",
            )
        server.zensim("delete", "r3")
        for joiner in joiners:
            joiner.undeclare()
    assert sorted(samples) == sorted(keys)


@pytest.mark.parametrize(
    ("kind", "published", "resource"),
    [
        (ros.SPAWN_V1, ros.SPAWN_V1_HASH, {"uri": "box_bot"}),
        (SPAWN, ros.SPAWN_V2_HASH, {"entity_resource": {"uri": "box_bot"}}),
    ],
    ids=["1.x", "2.1"],
)
def test_robot_is_spawned_listed_and_deleted(
    server: Server,
    installation: Installation,
    kind: str,
    published: str,
    resource: dict[str, object],
) -> None:
    # Humble has 1.x only; clients of 2.1 have hashes.
    type_hash = installation.hash_of(published) if kind == ros.SPAWN_V1 else published

    with ros_client(server) as call_service:
        spawned = call_service(
            "/spawn_entity", kind, type_hash, name="s", initial_pose=AT_SIDE, **resource
        )
        there = call_service(
            "/get_entities", GET_ENTITIES, installation.hash_of(ros.GET_ENTITIES_HASH)
        )
        deleted = call_service(
            "/delete_entity", DELETE, installation.hash_of(ros.DELETE_HASH), entity="s"
        )

    assert (result_of(spawned), result_of(deleted)) == (ResultCode.OK, ResultCode.OK)
    assert there is not None
    assert "s" in there["entities"]  # type: ignore[operator]
