"""Messages of single robots, made of the odometry of their fleet."""

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

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
from zensim.proto.messages.model_messages import GroundTruth, Joint, Model, Origin
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    Event,
    EventKind,
    GetModelsRequest,
    GetModelsResponse,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.service_catalog import GET_MODELS
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.recording import fleet_messages
from zensim.recording.fleet_messages import FleetMessages
from zensim.recording.fleet_robots import FleetSelection, is_of_many
from zensim.recording.recorded_topics import TopicTable
from zensim.robot_agent.fleet_odometry import make_messages
from zensim.robot_agent.pool.pooled_robots import PooledRobots

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

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
        self.deleted: set[str] = set()
        self.described: dict[str, Model] = {}
        """Models before their agent has set other rates."""
        self.taken: set[str] = set()
        self.requests: list[GetModelsRequest] = []
        self._services = self.bus.serve(keys.services(WORLD))
        self.bus.pumps += [self._reply, self.pool.reply_to_queries]
        self._draws = np.random.default_rng(3)
        self._single = self.bus.subscribe("*/*", 10_000)
        self.add(*models)
        self.step(0)
        table = TopicTable(WORLD, lambda *_: True)
        self.fleet = FleetMessages(
            cast("Bus", self.bus), WORLD, FleetSelection(expressions, table.find)
        )

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
        self.pool.reply_to_queries()  # it declares the publishers of new robots
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
        self.fleet.collect(epoch)
        taken = list(self.fleet.take())
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
            present = {one.entity: one for one in self.claims if one.entity not in self.deleted}
            names = request.entities or tuple(present)
            self.requests.append(request)
            is_found = all(name in present for name in names)
            wanted = [present[name] for name in names] if is_found else []
            response = GetModelsResponse(
                result=Result() if is_found else Result(ResultCode.NOT_FOUND),
                entities=tuple(
                    EntityModel(one.entity, one.namespace, number, "pool")
                    for number, one in enumerate(wanted)
                ),
                models=tuple(self.described.get(one.entity, one.model) for one in wanted),
            )
            assert call.name == GET_MODELS.name
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))


@pytest.fixture(autouse=True)
def no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let robots that are new be found at once, and those without odometry be missed."""
    monkeypatch.setattr(fleet_messages, "QUERY_PERIOD_S", 0.0)
    monkeypatch.setattr(fleet_messages, "MISSED_S", -1.0)


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
    by_robot = fleet.fleet.find_single_keys(0)  # their transforms have another rate
    assert found == {key: newest[key] for key in of_robots.difference(by_robot)}
    assert len(found) >= 2 * len(MODELS) - 3
    assert fleet.take() == {}


def test_transforms_with_a_rate_of_their_own_are_subscribed_to_by_robot() -> None:
    drive = msgspec.structs.replace(DRIVE, tf_rate_hz=5.0, update_rate_hz=50.0)
    fleet = Fleet(two_wheeler(drive), two_wheeler())

    fleet.step(SECOND_NS)

    assert set(fleet.take()) == {"r0/odom", "r1/odom", "r1/tf"}
    assert fleet.fleet.find_single_keys(SECOND_NS) == {"r0/tf"}


def test_rate_that_an_agent_gives_to_transforms_is_known() -> None:
    drive = msgspec.structs.replace(DRIVE, tf_rate_hz=5.0, update_rate_hz=50.0)
    fleet = Fleet(two_wheeler(drive), two_wheeler())
    fleet.described["e0"] = two_wheeler()
    fleet.fleet.clear()

    assert pass_seconds(fleet, 0, 1) == {"r0/tf"}
    assert fleet.taken == {"r0/odom", "r1/odom", "r1/tf"}


@pytest.mark.parametrize(
    ("expressions", "expected"),
    [(("*/odom",), {"r0/odom"}), (("**/tf",), {"r0/tf"}), (("x/*/tf",), set())],
)
def test_only_selected_topics_are_made(expressions: tuple[str, ...], expected: set[str]) -> None:
    fleet = Fleet(two_wheeler(), expressions=expressions)

    def is_chosen(name: str, _: str | None) -> bool:
        return any(keys.intersect(one, name[1:]) for one in expressions)

    chosen = TopicTable(WORLD, is_chosen)
    made = FleetMessages(cast("Bus", fleet.bus), WORLD, FleetSelection(expressions, chosen.find))

    fleet.step(SECOND_NS)
    made.collect(0)

    assert {topic.name[1:] for _, topic, _ in made.take()} == expected


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


FAULT = TopicFault(("r1/odom",), "sensor_off")


def pass_seconds(
    fleet: Fleet, start: int, end: int, faults: Sequence[TopicFault] = ()
) -> AbstractSet[str]:
    """Pass from one second to another in tenths; return the keys that are single at last."""
    found: AbstractSet[str] = set()
    for tenth in range(10 * start + 1, 10 * end + 1):
        now_ns = tenth * SECOND_NS // 10
        fleet.step(now_ns, faults=faults)
        fleet.fleet.collect(0)
        found = fleet.fleet.find_single_keys(now_ns)
        fleet.taken = {topic.name.lstrip("/") for _, topic, _ in fleet.fleet.take()}
    return found


def test_topics_of_a_robot_with_a_fault_are_subscribed_to_after_a_second() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())

    assert pass_seconds(fleet, 0, 1, [FAULT]) == set()
    assert pass_seconds(fleet, 1, 3, [FAULT]) == {"r1/odom", "r1/tf"}
    assert fleet.taken == {"r0/odom", "r0/tf"}


def test_robot_is_taken_from_its_agent_again_after_a_fault() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    pass_seconds(fleet, 0, 3, [FAULT])

    assert pass_seconds(fleet, 3, 4) == set()
    assert fleet.taken == {"r0/odom", "r0/tf", "r1/odom", "r1/tf"}


def test_robot_is_not_missed_before_wall_time_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet_messages, "MISSED_S", 3600.0)
    fleet = Fleet(two_wheeler())

    found = [fleet.fleet.find_single_keys(second * SECOND_NS) for second in range(1, 60)]

    assert not any(found)


def test_fault_is_noticed_after_a_reset_to_0() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    pass_seconds(fleet, 50, 60)
    fleet.fleet.collect(1)

    for tenth in range(30):
        found = fleet.fleet.find_single_keys(tenth * SECOND_NS // 10)

    assert found == {"r0/odom", "r0/tf", "r1/odom", "r1/tf"}


def test_topics_of_a_robot_with_a_fault_are_left_when_it_is_deleted() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    pass_seconds(fleet, 0, 3, [FAULT])

    fleet.fleet.note_event(Event("deleted", "e1"))
    found = fleet.fleet.find_single_keys(3 * SECOND_NS)
    taken = pass_seconds(fleet, 3, 4)

    assert found == taken == set()
    assert fleet.taken == {"r0/odom", "r0/tf", "r1/odom", "r1/tf"}  # it was spawned again


def test_keys_are_the_same_after_each_loading_of_a_world() -> None:
    drive = msgspec.structs.replace(DRIVE, tf_rate_hz=5.0, update_rate_hz=50.0)
    fleet = Fleet(two_wheeler(drive))

    for second in range(3):
        fleet.fleet.note_event(Event("loaded"))
        assert pass_seconds(fleet, second, second + 1) == {"r0/tf"}


def test_deleted_robot_does_not_hide_a_new_one() -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    fleet.step(SECOND_NS)
    fleet.deleted.add("e1")
    fleet.fleet.note_event(Event("deleted", "e1"))
    fleet.add(two_wheeler())
    fleet.step(2 * SECOND_NS)  # its agent has not released the robot
    fleet.take()

    fleet.step(3 * SECOND_NS)

    assert set(fleet.take()) == {"r0/odom", "r0/tf", "r2/odom", "r2/tf"}


def test_names_of_no_robots_are_asked_for_less_and_less(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    now_s = [0.0]
    monkeypatch.setattr(fleet_messages, "QUERY_PERIOD_S", 1.0)
    monkeypatch.setattr(fleet_messages, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    fleet.fleet.clear()
    fleet.take()
    fleet.deleted.add("e1")
    fleet.fleet.note_event(Event("deleted", "e1"))
    fleet.requests.clear()
    for second in range(1, 41):
        now_s[0] = float(second)
        fleet.step(second * SECOND_NS)
        fleet.take()

    assert len(fleet.requests) <= 2 * 8


def test_transforms_without_a_reply_are_subscribed_to(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    monkeypatch.setattr(MemoryBus, "get", leave_out(MemoryBus.get, "r1/tf"))
    fleet.fleet.clear()

    assert pass_seconds(fleet, 0, 1) == {"r1/tf"}
    assert fleet.taken == {"r0/odom", "r0/tf", "r1/odom"}


def test_robot_without_replies_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    whole = MemoryBus.get
    monkeypatch.setattr(MemoryBus, "get", leave_out(whole, "r1/odom"))
    fleet.fleet.clear()
    fleet.step(SECOND_NS)
    before = set(fleet.take())
    monkeypatch.setattr(MemoryBus, "get", whole)
    fleet.step(2 * SECOND_NS)
    fleet.take()
    fleet.step(3 * SECOND_NS)

    assert before == {"r0/odom", "r0/tf"}
    assert set(fleet.take()) == {"r0/odom", "r0/tf", "r1/odom", "r1/tf"}


def test_robot_that_never_replies_is_subscribed_to(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(two_wheeler(), two_wheeler())
    monkeypatch.setattr(MemoryBus, "get", leave_out(MemoryBus.get, "r1/odom"))
    fleet.fleet.clear()

    assert pass_seconds(fleet, 0, 1) == {"r1/odom", "r1/tf"}


def leave_out(get: Callable[..., list[Sample]], key: str) -> Callable[..., list[Sample]]:
    """Make a method that gets all replies but one."""
    return lambda *given, **named: [one for one in get(*given, **named) if one.key != key]


def test_rows_and_groups_do_not_grow_as_robots_come_and_go() -> None:
    fleet = Fleet(*[two_wheeler()] * 8)
    fleet.step(SECOND_NS)
    fleet.take()
    grown = []
    for number in range(2, 42):
        fleet.fleet.note_event(Event("deleted", f"e{number % 8}"))
        for half in range(2):
            fleet.step((2 * number + half) * SECOND_NS)
            taken = fleet.take()
        grown.append(count_rows(fleet.fleet))
        assert len(taken) == 16

    assert max(grown) <= 16 + 24


def count_rows(fleet: FleetMessages) -> int:
    groups = cast("list[Any]", vars(fleet)["_groups"])
    return len(vars(fleet)["_table"].times_ns) + sum(len(one.slots) for one in groups)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("**/odom", {"r0/base/odom", "r0/tf", "r1/odom", "r1/tf"}),
        ("*/odom", {"r1/odom", "r1/tf", "r0/tf"}),
    ],
)
def test_odometry_on_a_topic_of_its_own_is_taken(expression: str, expected: set[str]) -> None:
    drive = msgspec.structs.replace(DRIVE, odometry_topic="base/odom")
    fleet = Fleet(two_wheeler(drive), two_wheeler(), expressions=(expression, "**/tf"))

    single = pass_seconds(fleet, 0, 1)

    assert fleet.taken | single == expected


def test_topic_with_two_publishers_is_subscribed_to() -> None:
    model = msgspec.structs.replace(two_wheeler(), ground_truths=(GroundTruth("base_link"),))
    fleet = Fleet(model, two_wheeler())

    assert pass_seconds(fleet, 0, 1) == {"r0/odom", "r0/tf"}
    assert fleet.taken == {"r1/odom", "r1/tf"}


def test_transforms_of_an_agent_that_sends_no_joints_are_subscribed_to() -> None:
    fleet = Fleet(two_wheeler())
    fleet.has_positions = False

    for second in (1, 2):
        fleet.step(second * SECOND_NS)
        assert set(fleet.take()) == {"r0/odom"}
        assert fleet.fleet.find_single_keys(second * SECOND_NS) == {"r0/tf"}
    fleet.has_positions = True

    assert pass_seconds(fleet, 2, 3) == {"r0/tf"}
    assert fleet.taken == {"r0/odom"}


def test_messages_of_a_later_epoch_wait_for_the_clock() -> None:
    fleet = Fleet(two_wheeler())
    last = fleet.step(SECOND_NS)
    fleet.pool.reset()
    published = fleet.step(0, epoch=1)

    before, after = fleet.take(epoch=0), fleet.take(epoch=1)

    assert before == last
    assert after == select(published, ["r0/odom", "r0/tf"])


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("deleted", set()), ("loaded", {"r0/odom", "r0/tf"}), ("paused", {"r0/odom", "r0/tf"})],
)
def test_robot_is_taken_until_it_is_deleted(kind: EventKind, expected: set[str]) -> None:
    fleet = Fleet(two_wheeler())

    fleet.fleet.note_event(Event(kind, "e0"))
    fleet.step(SECOND_NS)

    assert set(fleet.take()) == expected


def test_robot_without_an_agent_is_not_missed() -> None:
    fleet = Fleet(two_wheeler())
    fleet.fleet.note_event(Event("released", "e0"))

    taken = [fleet.fleet.find_single_keys(second * SECOND_NS) for second in range(1, 6)]
    fleet.fleet.note_event(Event("claimed", "e0"))
    missed = [fleet.fleet.find_single_keys(second * SECOND_NS) for second in range(6, 10)]

    assert not any(taken)
    assert missed[-1] == {"r0/odom", "r0/tf"}


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
