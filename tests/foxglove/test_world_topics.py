"""What is known of a world, while another thread reads models."""

from collections.abc import Callable

from tests.foxglove.fake_bus import FakeBus, FakeTokens
from zensim.foxglove.world_topics import WorldTopics
from zensim.proto.messages.model_messages import Link, Model
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint, GraphNode, make_endpoint_token

DOMAIN = 0
PUBLISHER = GraphEndpoint(
    node=GraphNode(domain=DOMAIN, zid="1", number=1, name="n"),
    number=2,
    kind="MP",
    name="/r9/odom",
    ros_type="nav_msgs/msg/Odometry",
    type_hash="RIHS01_0",
)


class InterruptedKey(str):
    """A key of a token whose search another thread interrupts."""

    interrupt: Callable[[], object]

    def __hash__(self) -> int:
        self.interrupt()
        return super().__hash__()


def test_models_that_come_while_tokens_are_read_are_not_lost() -> None:
    bus, tokens, key = FakeBus(), FakeTokens(), InterruptedKey("gone")
    servers = FakeTokens()
    bus.watch_tokens = lambda _key, _depth=0: tokens if "**" in _key else servers  # type: ignore[method-assign]
    watch = WorldTopics(bus.as_bus, "w", DOMAIN)
    tokens.changes = [(make_endpoint_token(PUBLISHER), True)]
    watch.take()
    robot = EntityModel("r1", "r1", 0, "a")
    bus.models = GetModelsResponse(entities=(robot,), models=(Model("m", (Link("base"),)),))
    outcomes: list[object] = []
    key.interrupt = lambda: outcomes.extend(job() for job in watch.take_jobs())
    tokens.changes = [(key, False)]
    watch.take()

    for outcome in outcomes:
        if callable(outcome):
            outcome()

    topics = watch.take()
    assert topics is not None
    assert "/r1/robot_description" in topics
