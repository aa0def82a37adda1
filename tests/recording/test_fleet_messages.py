"""Messages of single robots, made of the odometry of their fleet."""

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import DRIVE, an_arm_bot, two_wheeler
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import Claim, DriveState
from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.model_messages import Joint, Model, Origin
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    Event,
    EventKind,
    GetModelsRequest,
    GetModelsResponse,
)
from zensim.proto.service_catalog import GET_MODELS
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.recording import fleet_messages
from zensim.recording.fleet_messages import FleetMessages
from zensim.recording.fleet_robots import FleetSelection, is_of_many
from zensim.recording.recorded_topics import TopicTable
from zensim.robot_agent.fleet_odometry import make_messages
from zensim.robot_agent.pool.pooled_robots import PooledRobots

WORLD = "default"
SECOND_NS = 1_000_000_000
SLIDE = Joint("slide", "prismatic", "base_link", "cart", Origin((0.1, 0.0, 0.2)), (0.6, 0.0, 0.8))
MODELS = (
    *(robot_of(drive) for drive in DRIVES.values()),
    an_arm_bot(),
    two_wheeler(joints=(*two_wheeler().joints, SLIDE)),
)


class Fleet:
    """Robots of a pool, and what a recorder of their topics gets."""

    def __init__(self, *models: Model, expressions: tuple[str, ...] = ("*/odom", "*/tf")) -> None:
        self.bus = MemoryBus()
        self.pool = PooledRobots(self.bus, SECOND_NS)
        self.claims: list[Claim] = []
        self.has_positions = True
        self._services = self.bus.serve(keys.services(WORLD))
        self.bus.pumps += [self._reply, self.pool.reply_to_queries]
        self._draws = np.random.default_rng(3)
        self._single = self.bus.subscribe("*/*", 10_000)
        self.add(*models)
        self.step(0)
        table = TopicTable(WORLD, lambda *_: True)
        self.fleet = FleetMessages(self.bus, WORLD, FleetSelection(expressions, table.find))

    def add(self, *models: Model) -> None:
        for model in models:
            number = len(self.claims)
            self.claims.append(Claim(number + 1, f"e{number}", f"r{number}", model, "<robot/>"))
        self.pool.add_claims(self.claims[-len(models) :])

    def step(
        self, time_ns: int, *, epoch: int = 0, faults: Sequence[TopicFault] = ()
    ) -> dict[str, bytes]:
        """Pass to a time with random states; return what the robots themselves published."""
        state = self._draw_state(time_ns, epoch)
        state = msgspec.structs.replace(state, topic_faults=tuple(faults))
        self.pool.advance(state)
        self.pool.publish()
        for message in make_messages(state, self.pool.list_odometry()):
            sent = (
                message
                if self.has_positions
                else msgspec.structs.replace(message, joint_positions=b"")
            )
            self.bus.put_message(FLEET_ODOMETRY.key(WORLD, "pool"), sent, Format.MSGPACK)
        return {
            one.key: one.payload
            for one in self._single.take()
            if one.key.rsplit("/", 1)[-1] in ("odom", "tf")
        }

    def take(self, epoch: int = 0) -> dict[str, bytes]:
        self.fleet.collect()
        taken = list(self.fleet.take(epoch))
        found = {topic.name.lstrip("/"): payload for _, topic, payload in taken}
        assert len(found) == len(taken)
        return found

    def _draw_state(self, time_ns: int, epoch: int) -> DriveState:
        base = self._draws.uniform(-2.0, 2.0, (len(self.claims), 13))
        base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
        joints = sum(len(one.model.joints) for one in self.claims)
        claims = np.array([one.claim for one in self.claims], dtype="<u4").tobytes()
        positions, speeds = (self._draws.uniform(-3.0, 3.0, joints).tobytes() for _ in range(2))
        step = time_ns // 10_000_000
        return DriveState(epoch, step, time_ns, claims, base.tobytes(), positions, speeds)

    def _reply(self) -> None:
        for call in self._services.take():
            request = call.read(GetModelsRequest)
            wanted = [
                one for one in self.claims if not request.entities or one.entity in request.entities
            ]
            response = GetModelsResponse(
                entities=tuple(
                    EntityModel(one.entity, one.namespace, number, "pool")
                    for number, one in enumerate(wanted)
                ),
                models=tuple(one.model for one in wanted),
            )
            assert call.name == GET_MODELS.name
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))


@pytest.fixture(autouse=True)
def no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let robots that are new be found at once."""
    monkeypatch.setattr(fleet_messages, "QUERY_PERIOD_S", 0.0)


def select(published: dict[str, bytes], names: Sequence[str]) -> dict[str, bytes]:
    return {key: payload for key, payload in published.items() if key in names}


def test_messages_are_those_of_the_robots_bit_by_bit() -> None:
    fleet = Fleet(*MODELS)
    newest: dict[str, bytes] = {}
    for step in range(1, 12):
        newest.update(fleet.step(step * 17_000_000))

    found = fleet.take()

    has_odometry = {key.removesuffix("/odom") for key in newest if key.endswith("/odom")}
    of_robots = {key for key in newest if key.split("/")[0] in has_odometry}
    by_robot = fleet.fleet.take_single_keys(0)  # their transforms have another rate
    assert found == {key: newest[key] for key in of_robots.difference(by_robot)}
    assert len(found) >= 2 * len(MODELS) - 3
    assert fleet.take() == {}


def test_transforms_with_a_rate_of_their_own_are_subscribed_to_by_robot() -> None:
    drive = msgspec.structs.replace(DRIVE, tf_rate_hz=5.0, update_rate_hz=50.0)
    fleet = Fleet(two_wheeler(drive), two_wheeler())

    fleet.step(SECOND_NS)

    assert set(fleet.take()) == {"r0/odom", "r1/odom", "r1/tf"}
    assert fleet.fleet.take_single_keys(SECOND_NS) == ["r0/tf"]


@pytest.mark.parametrize(
    ("expressions", "expected"),
    [(("*/odom",), {"r0/odom"}), (("**/tf",), {"r0/tf"}), (("x/*/tf",), set())],
)
def test_only_selected_topics_are_made(expressions: tuple[str, ...], expected: set[str]) -> None:
    fleet = Fleet(two_wheeler(), expressions=expressions)

    def is_chosen(name: str, _: str | None) -> bool:
        return any(keys.intersect(one, name[1:]) for one in expressions)

    chosen = TopicTable(WORLD, is_chosen)
    made = FleetMessages(fleet.bus, WORLD, FleetSelection(expressions, chosen.find))

    fleet.step(SECOND_NS)
    made.collect()

    assert {topic.name[1:] for _, topic, _ in made.take(0)} == expected


def test_robot_that_comes_later_is_found_by_its_odometry() -> None:
    fleet = Fleet(two_wheeler())
    fleet.add(two_wheeler(), robot_of(DRIVES["diff"]))

    fleet.step(SECOND_NS)
    fleet.take()
    published = fleet.step(2 * SECOND_NS)

    assert fleet.take() == published
    assert {"r1/tf", "r2/odom"} <= published.keys()


def test_odometry_of_known_robots_goes_on_while_another_is_new(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = Fleet(two_wheeler())
    monkeypatch.setattr(fleet_messages, "QUERY_PERIOD_S", 3600.0)
    fleet.add(two_wheeler())

    published = fleet.step(SECOND_NS)

    assert fleet.take() == select(published, ["r0/odom", "r0/tf"])


def test_topics_of_a_robot_with_a_fault_are_subscribed_to_after_a_second() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    fault = TopicFault(("r1/odom",), "sensor_off")
    taken = []
    for tenth in range(1, 25):
        now_ns = tenth * SECOND_NS // 10
        fleet.step(now_ns, faults=[fault])
        assert set(fleet.take()) == {"r0/odom", "r0/tf"}
        taken += fleet.fleet.take_single_keys(now_ns)

    assert taken == ["r1/odom", "r1/tf"]


def test_robot_that_is_subscribed_to_is_taken_from_its_agent_no_more() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    fault = TopicFault(("r1/odom",), "sensor_off")
    for tenth in range(1, 25):
        fleet.step(tenth * SECOND_NS // 10, faults=[fault])
        fleet.take()
        fleet.fleet.take_single_keys(tenth * SECOND_NS // 10)

    fleet.step(3 * SECOND_NS)

    assert set(fleet.take()) == {"r0/odom", "r0/tf"}


def test_transforms_of_an_agent_that_sends_no_joints_are_subscribed_to() -> None:
    fleet = Fleet(two_wheeler())
    fleet.has_positions = False

    for second in (1, 2):
        fleet.step(second * SECOND_NS)
        assert set(fleet.take()) == {"r0/odom"}

    assert fleet.fleet.take_single_keys(2 * SECOND_NS) == ["r0/tf"]
    assert fleet.fleet.take_single_keys(2 * SECOND_NS) == []


def test_messages_of_a_later_epoch_wait_for_the_clock() -> None:
    fleet = Fleet(two_wheeler())
    fleet.step(SECOND_NS)
    fleet.pool.reset()
    published = fleet.step(0, epoch=1)

    before, after = fleet.take(epoch=0), fleet.take(epoch=1)

    assert before == {}
    assert after == select(published, ["r0/odom", "r0/tf"])


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("deleted", set()), ("loaded", {"r0/odom", "r0/tf"}), ("paused", {"r0/odom", "r0/tf"})],
)
def test_robot_is_taken_until_it_is_deleted(kind: EventKind, expected: set[str]) -> None:
    fleet = Fleet(two_wheeler())

    fleet.fleet.note_event(Event(kind, "e0"))
    fleet.step(SECOND_NS)
    fleet.fleet.collect()

    assert {topic.name[1:] for _, topic, _ in fleet.fleet.take(0)} == expected


def test_robot_without_an_agent_is_not_missed() -> None:
    fleet = Fleet(two_wheeler())
    fleet.fleet.note_event(Event("released", "e0"))

    taken = [fleet.fleet.take_single_keys(second * SECOND_NS) for second in range(1, 6)]
    fleet.fleet.note_event(Event("claimed", "e0"))
    missed = [fleet.fleet.take_single_keys(second * SECOND_NS) for second in range(6, 10)]

    assert taken == [[]] * 5
    assert [key for one in missed for key in one] == ["r0/odom", "r0/tf"]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("*/odom", True),
        ("**/tf", True),
        ("r$*/odom", True),
        ("r1/odom", False),
        ("*/scan", False),
        ("tf", False),
    ],
)
def test_expressions_of_many_robots_are_known(expression: str, *, expected: bool) -> None:
    assert is_of_many(expression) is expected
