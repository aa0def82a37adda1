"""A pool drives and publishes as individual robots do."""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fakes import MemoryBus
from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import DRIVE, an_arm_bot, two_wheeler
from tests.robot_agent.pool.pool_samples import a_state
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode
from zensim.proto.keys import last_chunk
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.drive_messages import Drive, RosBlock
from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.model_messages import GroundTruth, Model, Origin, Sensor
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import (
    AltimeterSensor,
    ImuSensor,
    MagnetometerSensor,
    NavsatSensor,
    Noise,
    SensorTopic,
)
from zensim.proto.messages.standard_messages import (
    Altimeter,
    Imu,
    JointState,
    MagneticField,
    NavSatFix,
    Odometry,
    TFMessage,
    Twist,
    Vector3,
    Vector3Stamped,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.liveliness_tokens import parse_endpoint_token
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.ros_choice import BridgedCommand
from zensim.proto.topic_catalog import select_ros_topics
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots
from zensim.robot_agent.topic_remapping import find_topic_keys

TIMEOUT_NS = 100_000_000
KINDS: dict[str, type[msgspec.Struct]] = {
    "odom": Odometry,
    "tf": TFMessage,
    "joint_states": JointState,
    "imu": Imu,
    "gps": NavSatFix,
    "gps_vel": Vector3Stamped,
    "altimeter": Altimeter,
    "magnetic_field": MagneticField,
}
ENVIRONMENT = Environment(seed=3, step_ns=12_500_000, control_steps=1)
NOISY = (Noise("gaussian", stddev=0.1),) * 3
SENSORS = (
    Sensor(
        *("front", "imu", "base_link", "base_link", Origin((0.1, 0.2, 0.3))),
        settings=ImuSensor(NOISY, NOISY),
        topics=(SensorTopic("imu", "front/imu"),),
        frame_id="imu_link",
    ),
    Sensor(
        *("wheel", "imu", "left_wheel", "left_wheel", Origin(), 40.0),
        settings=ImuSensor(reference="spawn"),
        topics=(SensorTopic("imu", "wheel/imu"),),
        frame_id="left_wheel",
    ),
    Sensor(
        *("gps", "gps", "base_link", "camera", Origin((0.2, 0.0, 0.1)), 10.0),
        settings=NavsatSensor(NOISY[0], NOISY[0], NOISY[0], NOISY[0]),
        topics=(SensorTopic("fix", "gps"), SensorTopic("vel", "gps_vel")),
        frame_id="camera",
        compat="gazebo11",
    ),
    Sensor(
        *("height", "altimeter", "base_link", "base_link"),
        settings=AltimeterSensor(),
        topics=(SensorTopic("altimeter", "altimeter"),),
        frame_id="base_link",
    ),
    Sensor(
        *("compass", "magnetometer", "base_link", "base_link"),
        settings=MagnetometerSensor(),
        topics=(SensorTopic("magnetic_field", "magnetic_field"),),
        frame_id="base_link",
    ),
)
PERIODS_NS = (12_500_000, 10_000_000, 4_166_667)


def list_numbers(message: object) -> Iterator[float]:
    """List all numbers of a message."""
    if isinstance(message, float | int):
        yield float(message)
    elif isinstance(message, tuple | list):
        for item in message:
            yield from list_numbers(item)
    elif isinstance(message, msgspec.Struct):
        yield from list_numbers(msgspec.structs.astuple(message))


def list_texts(message: object) -> Iterator[str]:
    """List all texts of a message."""
    if isinstance(message, str):
        yield message
    elif isinstance(message, tuple | list):
        for item in message:
            yield from list_texts(item)
    elif isinstance(message, msgspec.Struct):
        yield from list_texts(msgspec.structs.astuple(message))


def assert_same(found: Sample, expected: Sample) -> None:
    assert (found.key, found.encoding) == (expected.key, expected.encoding)
    kind = KINDS[last_chunk(found.key)]
    one, other = (decode(kind, sample.payload, sample.encoding) for sample in (found, expected))
    assert list(list_texts(one)) == list(list_texts(other))
    numbers, others = list(list_numbers(one)), list(list_numbers(other))
    assert numbers == pytest.approx(others, abs=1e-12, nan_ok=True)


def targets_of(command: DriveCommand) -> tuple[float, ...]:
    return struct.unpack(f"<{len(command.targets) // 8}d", command.targets)


def list_motion(message: Odometry) -> list[float]:
    pose, twist = message.pose.pose, message.twist.twist
    return list(list_numbers((pose.position, pose.orientation, twist.linear, twist.angular)))


class Both:
    """The same robots twice: in a pool, and one by one."""

    def __init__(self) -> None:
        self.buses = MemoryBus(), MemoryBus()
        self.pool = PooledRobots(self.buses[0], TIMEOUT_NS)
        self.individual = IndividualRobots(self.buses[1], TIMEOUT_NS)
        self.received = [bus.subscribe("**", 100_000) for bus in self.buses]
        self.claims: list[Claim] = []
        self.time_ns = 0
        self.has_efforts = True

    def take(self, *models: Model, namespace: str = "") -> None:
        for model in models:
            number = len(self.claims) + 1
            name = f"{namespace}r{number}"
            self.claims.append(
                Claim(number, f"r{number}", name, model, "<robot/>", environment=ENVIRONMENT)
            )
            for one in (self.pool, self.individual):
                one.add_claims(self.claims[-1:])
        for _ in range(len(self.claims)):
            self.pool.reply_to_queries()
            self.pool.announce()

    def command(self, message: Twist, format_: Format, *claims: Claim) -> None:
        for bus in self.buses:
            for claim in claims:
                bus.put_message(f"{claim.namespace}/cmd_vel", message, format_)

    def state(self, rng: np.random.Generator, claims: Sequence[Claim]) -> DriveState:
        joints = sum(len(claim.model.joints) for claim in claims)
        base = rng.uniform(-2.0, 2.0, (len(claims), 13))
        base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
        return DriveState(
            0,
            self.time_ns,
            self.time_ns,
            np.array([claim.claim for claim in claims], dtype="<u4").tobytes(),
            base.tobytes(),
            rng.uniform(-3.0, 3.0, joints).tobytes(),
            rng.uniform(-3.0, 3.0, joints).tobytes(),
            joint_efforts=rng.uniform(-3.0, 3.0, joints).tobytes() if self.has_efforts else b"",
        )

    def step(self, rng: np.random.Generator, period_ns: int, claims: Sequence[Claim]) -> None:
        """Pass time, and see that both do the same."""
        self.time_ns += period_ns
        state = self.state(rng, claims)
        for one in (self.pool, self.individual):
            one.release_all_except(state.claims)
        self.pool.reply_to_queries()
        found, expected = self.pool.advance(state), self.individual.advance(state)
        assert targets_of(found) == pytest.approx(targets_of(expected), abs=1e-12)
        self.pool.reply_to_queries()
        self.pool.publish()
        self.individual.publish()
        published = [
            sorted((s for s in received.take() if last_chunk(s.key) in KINDS), key=lambda s: s.key)
            for received in self.received
        ]
        for one, other in zip(*published, strict=True):
            assert_same(one, other)
        self.check_odometry(published[1])

    def check_odometry(self, published: Sequence[Sample]) -> None:
        """See that the rows of both are the messages of `odom`."""
        entities = {find_topic_keys(claim).odom: claim.entity for claim in self.claims}
        messages = {
            entities[sample.key]: decode(Odometry, sample.payload, sample.encoding)
            for sample in published
            if sample.key in entities
        }
        expected = {entity: list_motion(message) for entity, message in messages.items()}
        for one in (self.pool, self.individual):
            rows = {
                name: numbers.tolist()
                for names, motions, *_ in one.list_odometry()
                for name, numbers in zip(
                    names, np.frombuffer(motions, dtype="<f8").reshape(-1, 13), strict=True
                )
            }
            assert rows.keys() == expected.keys()
            for entity, numbers in expected.items():
                assert rows[entity] == pytest.approx(numbers, abs=1e-12)


def a_twist(rng: np.random.Generator) -> Twist:
    numbers = rng.uniform(-2.0, 2.0, 6).tolist()
    return Twist(Vector3(*numbers[:3]), Vector3(*numbers[3:]))


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
@settings(max_examples=2, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(PERIODS_NS))
def test_pool_drives_and_publishes_as_individual_robots_do(
    drive: Drive, seed: int, period_ns: int
) -> None:
    rng, both = np.random.default_rng(seed), Both()
    both.take(*[robot_of(drive) for _ in range(3)])
    for step in range(25):
        if step == 8:
            both.take(robot_of(drive))
        claims = both.claims if step < 16 else [both.claims[3], both.claims[1]]
        if step % 5 == 0:
            both.command(a_twist(rng), Format.CDR, *claims[: step % 3 + 1])
        both.step(rng, period_ns, claims)


def test_pool_drives_robots_of_all_kinds_together() -> None:
    rng, both = np.random.default_rng(5), Both()
    both.take(*[robot_of(drive) for drive in DRIVES.values()])
    both.take(*[robot_of(drive) for drive in DRIVES.values()], namespace="team/")
    quiet = msgspec.structs.replace(DRIVE, publish_odom=False)
    truthful = msgspec.structs.replace(two_wheeler(quiet), ground_truths=(GroundTruth("camera"),))
    for step in range(30):
        if step == 10:
            both.take(truthful)
        for claim in both.claims:
            if rng.random() < 0.3:
                both.command(a_twist(rng), list(Format)[rng.integers(3)], claim)
        both.step(rng, 12_500_000, both.claims)


def test_pool_publishes_joint_states_without_efforts_as_individual_robots_do() -> None:
    rng, both = np.random.default_rng(3), Both()
    both.take(*[robot_of(drive) for drive in DRIVES.values()])
    both.has_efforts = False
    for _ in range(8):
        both.step(rng, 12_500_000, both.claims)


def test_pool_wants_efforts_while_joint_states_have_a_subscriber() -> None:
    bus, rng = MemoryBus(), np.random.default_rng(3)
    pool, both = PooledRobots(bus, TIMEOUT_NS), Both()
    both.take(robot_of(DRIVE), two_wheeler(None))
    pool.add_claims(both.claims)
    wanted = []
    for topic in ("odom", "joint_states"):
        listener = bus.subscribe(f"*/{topic}")
        for _ in range(3):
            pool.reply_to_queries()
            both.time_ns += 50_000_000
            wanted.append(pool.advance(both.state(rng, both.claims)).wants_efforts)
            pool.publish()
        listener.close()

    assert wanted[:3] == [False] * 3
    assert wanted[-1]


def test_pool_publishes_the_sensors_of_its_robots_as_individual_robots_do() -> None:
    rng, both = np.random.default_rng(11), Both()
    model = msgspec.structs.replace(two_wheeler(DRIVE), sensors=SENSORS)
    both.take(model, model)
    both.take(model, namespace="team/")
    for step in range(30):
        if step == 8:
            both.take(model, two_wheeler(DRIVE))
        claims = both.claims if step < 20 else [both.claims[3], both.claims[1]]
        both.step(rng, 12_500_000, claims)
    both.pool.reset()
    both.individual.reset()
    both.time_ns = 0
    for _ in range(9):
        both.step(rng, 12_500_000, claims)

    assert len(both.pool._robots) == 0  # noqa: SLF001 - all are in groups


def test_pool_publishes_as_many_sensor_messages_as_are_due() -> None:
    rng, both = np.random.default_rng(11), Both()
    both.take(*[msgspec.structs.replace(two_wheeler(DRIVE), sensors=SENSORS)] * 3)
    listener = both.buses[0].subscribe("*/**", 100_000)

    for _ in range(81):
        both.step(rng, 12_500_000, both.claims)

    counts = Counter(sample.key for sample in listener.take())
    assert counts["r2/front/imu"] == 80
    assert counts["r2/wheel/imu"] == pytest.approx(40, abs=1)
    assert counts["r2/gps"] == counts["r2/gps_vel"] == pytest.approx(10, abs=1)


@pytest.mark.parametrize("topic", ["odom", "tf"])
@pytest.mark.parametrize("kind", [PooledRobots, IndividualRobots], ids=["pool", "individual"])
def test_robot_whose_motion_has_a_fault_is_left_out_of_the_odometry_of_the_fleet(
    kind: type[PooledRobots] | type[IndividualRobots], topic: str
) -> None:
    robots = kind(MemoryBus(), TIMEOUT_NS)
    claims = [Claim(n, f"r{n}", f"r{n}", two_wheeler(), "<robot/>") for n in (1, 2, 3)]
    robots.add_claims(claims)
    off = TopicFault((f"r2/{topic}",), "sensor_off")
    state = msgspec.structs.replace(a_state(claims, 1), topic_faults=(off,))

    robots.advance(state)
    robots.publish()

    assert [name for one in robots.list_odometry() for name in one.entities] == ["r1", "r3"]


@pytest.mark.parametrize("kind", [PooledRobots, IndividualRobots], ids=["pool", "individual"])
def test_odometry_of_the_fleet_has_the_joints_of_its_rows(
    kind: type[PooledRobots] | type[IndividualRobots],
) -> None:
    robots = kind(MemoryBus(), TIMEOUT_NS)
    claims = [Claim(n, f"r{n}", f"r{n}", two_wheeler(), "<robot/>") for n in (1, 2)]
    robots.add_claims(claims)
    positions = np.array([0.1, 0.2, 0.3, 0.4], dtype="<f8").tobytes()

    robots.advance(msgspec.structs.replace(a_state(claims, 1), joint_positions=positions))
    robots.publish()

    assert b"".join(one.joint_positions for one in robots.list_odometry()) == positions


def test_robots_that_are_claimed_one_by_one_obey_commands_of_the_same_step() -> None:
    together, one_by_one = Both(), Both()
    rng = np.random.default_rng(1)
    for both in (together, one_by_one):
        both.take(two_wheeler(), two_wheeler())
    state = together.state(rng, together.claims)
    first = msgspec.structs.replace(
        state,
        claims=state.claims[:4],
        base=state.base[: len(state.base) // 2],
        joint_positions=state.joint_positions[: len(state.joint_positions) // 2],
        joint_velocities=state.joint_velocities[: len(state.joint_velocities) // 2],
        joint_efforts=state.joint_efforts[: len(state.joint_efforts) // 2],
    )
    together.pool.advance(state)
    pool = PooledRobots(one_by_one.buses[0], TIMEOUT_NS)
    pool.add_claims(one_by_one.claims[:1])
    pool.advance(first)
    pool.add_claims(one_by_one.claims[1:])
    pool.advance(state)
    for both in (together, one_by_one):
        both.command(Twist(Vector3(0.4)), Format.CDR, *both.claims)

    expected, found = together.pool.repeat(state), pool.repeat(state)

    assert any(targets_of(expected))
    assert targets_of(found) == targets_of(expected)


def test_pool_resets_its_robots() -> None:
    rng, both = np.random.default_rng(7), Both()
    both.take(*[robot_of(drive) for drive in DRIVES.values()])
    for _ in range(2):
        both.command(a_twist(rng), Format.CDR, *both.claims)
        for _ in range(9):
            both.step(rng, 12_500_000, both.claims)
        both.pool.reset()
        both.individual.reset()
        both.time_ns = 0


def test_pool_follows_remappings() -> None:
    rng, both = np.random.default_rng(3), Both()
    ros = RosBlock("", ("cmd_vel:=go", "odom:=/lost/odom"))
    drive = msgspec.structs.replace(DRIVES["diff"], ros=ros)
    both.take(robot_of(drive))
    for bus in both.buses:
        bus.put_message("r1/go", Twist(Vector3(0.5)))

    both.step(rng, 12_500_000, both.claims)
    both.step(rng, 12_500_000, both.claims)


def test_malformed_command_does_not_hide_the_valid_one_before_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rng, both = np.random.default_rng(3), Both()
    both.take(robot_of(DRIVES["diff"]), robot_of(DRIVES["diff"]))
    nan = Twist(Vector3(float("nan")))
    for bus in both.buses:
        bus.put_message("r1/cmd_vel", Twist(Vector3(0.5)))
        bus.put("r1/cmd_vel", b"garbage")
        bus.put_message("r2/cmd_vel", Twist(Vector3(0.25)))
        bus.put_message("r2/cmd_vel", nan)

    both.step(rng, 12_500_000, both.claims)
    both.pool.log_malformed()
    both.pool.log_malformed()

    assert [line.split(" reason")[0] for line in caplog.messages] == [
        "cmd_vel key=r1/cmd_vel malformed=1",
        "cmd_vel key=r2/cmd_vel malformed=1",
    ]


def test_pool_replies_for_its_own_robots_only() -> None:
    rng, both = np.random.default_rng(3), Both()
    both.take(robot_of(DRIVES["diff"]), robot_of(DRIVES["diff"]))
    bus = both.buses[0]
    bus.pumps.append(both.pool.reply_to_queries)
    assert bus.get("r1/odom") == []
    both.step(rng, 12_500_000, both.claims)

    topics = {"odom", "tf", "tf_static", "joint_states", "robot_description"}
    assert {sample.key for sample in bus.get("r1/*")} == {f"r1/{topic}" for topic in topics}
    assert {sample.key for sample in bus.get("*/tf_static")} == {"r1/tf_static", "r2/tf_static"}
    assert bus.get("r3/odom") == []
    for one in ("r2/odom", "r1/tf"):
        (other_bus_answer,) = _query(both, one)
        assert_same(bus.get(one)[0], other_bus_answer)


def _query(both: Both, key: str) -> list[Sample]:
    if both.individual.reply_to_queries not in both.buses[1].pumps:
        both.buses[1].pumps.append(both.individual.reply_to_queries)
    return both.buses[1].get(key)


def test_pool_announces_static_topics_to_each_new_subscriber() -> None:
    bus = MemoryBus()
    pool = PooledRobots(bus, 0)
    pool.add_claims(
        [Claim(n, f"r{n}", f"r{n}", robot_of(DRIVES["diff"]), "<robot/>") for n in (1, 2)]
    )

    def received(listener_key: str) -> list[str]:
        listener = bus.subscribe(listener_key, 16)
        for _ in range(4):
            pool.reply_to_queries()
            pool.announce()
        return [sample.key for sample in listener.take()]

    assert received("r1/tf_static") == ["r1/tf_static"]
    assert received("r2/*") == ["r2/tf_static", "r2/robot_description"]


def test_pool_announces_again_after_the_last_unsubscribe() -> None:
    bus = MemoryBus()
    pool = PooledRobots(bus, 0)
    pool.add_claims([Claim(1, "r1", "r1", robot_of(DRIVES["diff"]), "<robot/>")])
    for _ in range(2):
        listener = bus.subscribe("*/tf_static", 16)
        for _ in range(3):
            pool.reply_to_queries()
            pool.announce()
        assert len(listener.take()) == 1
        listener.close()
        for _ in range(2):
            pool.reply_to_queries()
            pool.announce()


@pytest.mark.parametrize("make", [PooledRobots, IndividualRobots])
def test_robots_have_the_selected_topics_in_ros_and_all_on_plain_keys(
    make: type[PooledRobots | IndividualRobots],
) -> None:
    bus = MemoryBus()
    settings = select_ros_topics(RosSettings(), "odom,cmd_vel")
    robots = make(bus, 0, RosGraph(bus, settings))
    claims = [Claim(1, "r1", "r1", robot_of(DRIVES["diff"]), "<robot/>")]
    robots.add_claims(claims)
    robots.advance(a_state(claims, 1))
    robots.publish()
    bus.pumps.append(robots.reply_to_queries)
    robots.reply_to_queries()

    found = [parse_endpoint_token(token) for token in bus.list_tokens("@ros2_lv/**")]

    endpoints = sorted((one.kind, one.key) for one in found if one is not None)
    assert endpoints == [("MP", "r1/odom"), ("MS", "r1/cmd_vel"), ("MS", "r1/cmd_vel")]
    assert {last_chunk(sample.key) for sample in bus.get("r1/*")} >= {"tf", "joint_states"}


def test_every_node_of_a_pool_has_parameter_services() -> None:
    bus = MemoryBus()
    pool = PooledRobots(bus, 0, RosGraph(bus, RosSettings()))
    claims = [Claim(1, "r1", "r1", robot_of(DRIVES["diff"]), "<robot/>")]
    pool.add_claims(claims)
    pool.advance(a_state(claims, 1))
    pool.publish()
    for _ in range(10):
        pool.announce()
        pool.reply_to_queries()

    tokens = map(parse_endpoint_token, bus.list_tokens("@ros2_lv/**"))
    endpoints = [one for one in tokens if one is not None]
    publishing = {one.node for one in endpoints if one.kind == "MP"}
    serving = {one.node for one in endpoints if one.key.endswith("/get_parameters")}

    assert any(node.endswith("_static") for node in publishing)
    assert publishing <= serving


@pytest.mark.parametrize("make", [PooledRobots, IndividualRobots])
@pytest.mark.parametrize(
    ("chosen", "name"), [("twist", "Twist"), ("twist_stamped", "TwistStamped")]
)
def test_bridge_sees_one_type_of_commands(
    make: type[PooledRobots | IndividualRobots], chosen: BridgedCommand, name: str
) -> None:
    bus = MemoryBus()
    settings = RosSettings(is_bridged=True, bridge_cmd_vel=chosen)
    robots = make(bus, 0, RosGraph(bus, settings))
    robots.add_claims([Claim(1, "r1", "r1", robot_of(DRIVES["diff"]), "<robot/>")])

    routes = [token.split("/")[3:6] for token in bus.list_tokens("@/*/@ros2_lv/MS/**")]

    assert routes == [["MS", "r1§cmd_vel", f"geometry_msgs§msg§{name}"]]
    assert len(bus.list_tokens("@ros2_lv/0/*/*/*/MS/**")) == 2


def test_pool_undeclares_everything_without_robots() -> None:
    rng, both = np.random.default_rng(3), Both()
    both.take(robot_of(DRIVES["diff"]), robot_of(DRIVES["car"]))
    both.step(rng, 12_500_000, both.claims)

    lost = both.pool.release_all_except(b"")

    bus = both.buses[0]
    assert lost == ("r1", "r2")
    assert both.pool.newest_claim == 0
    assert not bus.is_served("**")
    assert bus.subscribed_keys == ["**"]


def test_pool_declares_nothing_without_subscribers() -> None:
    bus = MemoryBus()
    pool = PooledRobots(bus, 0)
    both = Both()
    both.take(robot_of(DRIVES["diff"]))
    pool.add_claims(both.claims)

    pool.advance(both.state(np.random.default_rng(1), both.claims))
    pool.reply_to_queries()
    pool.publish()

    assert not bus.has_subscriber("r1/odom")


@pytest.mark.parametrize("part", ["base", "joint_positions", "joint_velocities", "claims"])
def test_state_that_does_not_fit_is_malformed(part: str) -> None:
    both = Both()
    both.take(robot_of(DRIVES["diff"]))
    state = both.state(np.random.default_rng(1), both.claims)
    bad = msgspec.structs.replace(state, **{part: getattr(state, part) + b"\0"})

    with pytest.raises(MalformedPayload):
        both.pool.advance(bad)


def test_pool_commands_joints_as_individual_robots_do() -> None:
    """With robots without joints beside them, while robots come, go and are driven."""
    rng, both = np.random.default_rng(11), Both()
    arm = an_arm_bot()
    both.take(two_wheeler(DRIVE), arm, arm, msgspec.structs.replace(arm, drive=None))
    names = ("lift", "wrist", "left_joint")
    for step in range(40):
        if step == 15:
            both.take(arm, two_wheeler(DRIVE))
        claims = both.claims if step < 30 else both.claims[2:]
        for claim in claims:
            if rng.random() < 0.3:
                kind = ("position", "velocity", "effort")[rng.integers(3)]
                numbers = tuple(rng.uniform(-2.0, 2.0, 3).tolist())
                message = msgspec.structs.replace(JointState(name=names), **{kind: numbers})
                for bus in both.buses:
                    bus.put_message(f"{claim.namespace}/joint_commands", message)
                both.command(a_twist(rng), Format.CDR, claim)
        both.step(rng, 12_500_000, claims)
    both.pool.log_malformed()
    both.pool.reset()
    both.individual.reset()
    both.step(rng, 12_500_000, both.claims[2:])


def test_robot_of_a_pool_goes_on_with_the_joints_that_another_agent_has_left() -> None:
    both = Both()
    targets = (1.0, 0.7, 2.0, 0.0)
    claim = Claim(1, "r1", "r1", an_arm_bot(), "<robot/>", joint_targets=targets)
    for one in (both.pool, both.individual):
        one.add_claims([claim])
    state = both.state(np.random.default_rng(1), [claim])

    found, expected = both.pool.advance(state), both.individual.advance(state)

    assert targets_of(found)[2:] == targets_of(expected)[2:] == targets
