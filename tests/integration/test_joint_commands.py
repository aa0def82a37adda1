"""Joints of an arm on a robot: commands over the network, and trajectories by an action client.

The robot of `examples/arm` is driven by an agent of its own in one engine, by a pool in the other.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from tests.integration.processes import Server, eventually, running, serving, wait_for_agents
from tests.integration.ros_client_process import CallObserver, make_service_call, run_observer
from tests.proto.ros_hashes import hash_of_service
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.standard_messages import Float64MultiArray, JointState

EXAMPLE = Path(__file__).parents[2] / "examples" / "arm"
ACTION = "control_msgs/action/FollowJointTrajectory"
UNDER = "/r1/arm_controller/follow_joint_trajectory/_action"
SUCCEEDED, CANCELED = 4, 5
WITHIN_S = 40.0


@dataclass
class ArmTrial:
    """A server with the robot, and what it publishes."""

    server: Server
    states: BusSubscription

    def command(
        self,
        message: msgspec.Struct,
        joint: str,
        column: int,
        *,
        number: float,
        within: float,
        topic: str = "joint_commands",
    ) -> None:
        """Publish a command until a joint has a position, velocity or effort."""
        publisher = self.server.bus.advertise(f"r1/{topic}", make_encoding(message, Format.CDR))
        payload = encode(message, Format.CDR)
        self.wait_for(joint, column, number, within, lambda: publisher.send(payload))
        publisher.close()

    def joints(self) -> dict[str, tuple[float, float, float]] | None:
        """Read position, velocity and effort of all joints, by name."""
        if (sample := self.states.newest()) is None:
            return None
        state = decode(JointState, sample.payload, sample.encoding)
        columns = zip(state.position, state.velocity, state.effort, strict=True)
        return dict(zip(state.name, columns, strict=True))

    def wait_for(
        self,
        joint: str,
        column: int,
        number: float,
        within: float,
        repeat: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait until a joint has a position, velocity or effort."""
        last: list[object] = []

        def has_it() -> bool:
            repeat()
            joints = self.joints()
            last[:] = [joints or (last[0] if last else None)]
            return joints is not None and abs(joints[joint][column] - number) <= within

        eventually(has_it, WITHIN_S, f"{joint} at {number}, not {last}")


@pytest.fixture(
    scope="module",
    params=[("pybullet", ("r1",)), ("mujoco", ("--pool", "0", "--name", "p"))],
    ids=["pybullet-alone", "mujoco-pool"],
)
def trial(request: pytest.FixtureRequest) -> Iterator[ArmTrial]:
    engine, who = request.param
    with serving("--engine", engine, "--ros-domain", "0") as server:
        spawned = server.zensim(
            *("spawn", str(EXAMPLE / "arm_bot.urdf"), "--name", "r1"),
            *("--controllers", str(EXAMPLE / "controllers.yaml"), "-z", "0.12", "--json"),
        )
        assert spawned.returncode == 0, spawned.stderr
        with running("agent", *who, "--connect", server.endpoint):
            wait_for_agents(server, ("r1",))
            found = ArmTrial(server, server.bus.subscribe("r1/joint_states"))
            eventually(lambda: found.joints() is not None, WITHIN_S, "joint states")
            yield found


@pytest.fixture(scope="module")
def observe(trial: ArmTrial) -> Iterator[CallObserver]:
    with run_observer(trial.server, 0) as found:
        yield found


def test_joints_are_held_at_their_initial_positions_with_all_states(trial: ArmTrial) -> None:
    trial.wait_for("gripper", 0, 0.02, 0.002)
    trial.wait_for("shoulder", 0, 0.0, 0.01)

    joints = trial.joints() or eventually(trial.joints, WITHIN_S)
    assert joints is not None
    assert set(joints) == {
        *("left_wheel_joint", "right_wheel_joint", "shoulder", "elbow", "gripper")
    }


def test_positions_velocities_and_efforts_move_joints(trial: ArmTrial) -> None:
    both = JointState(name=("shoulder", "elbow"), position=(0.4, -0.6))
    trial.command(both, "shoulder", 0, number=0.4, within=0.01)
    trial.wait_for("elbow", 0, -0.6, 0.01)

    turning = JointState(name=("elbow",), velocity=(0.3,))
    trial.command(turning, "elbow", 1, number=0.3, within=0.05)
    trial.wait_for("elbow", 1, 0.0, 0.01)
    pushed = JointState(name=("elbow",), effort=(-2.0,))
    trial.command(pushed, "elbow", 2, number=-2.0, within=0.2)
    held = JointState(name=("elbow",), position=(0.0,))
    trial.command(held, "elbow", 0, number=0.0, within=0.01)


def test_controller_that_forwards_numbers_moves_the_gripper(trial: ArmTrial) -> None:
    numbers = Float64MultiArray(data=(0.04,))
    topic = "gripper_controller/commands"
    trial.command(numbers, "gripper", 0, number=0.04, within=0.002, topic=topic)


def send(observe: CallObserver, number: int, **goal: object) -> dict[str, object]:
    kind = f"{ACTION}_SendGoal"
    response = make_service_call(observe)(
        f"{UNDER}/send_goal",
        kind,
        hash_of_service(kind),
        goal_id={"uuid": [number, *range(15)]},
        trajectory={"joint_names": ["shoulder", "elbow"], "points": [goal]},
    )
    assert response is not None
    return response


def find_result(observe: CallObserver, number: int) -> tuple[object, object]:
    """Ask for the result again while it does not come: rmw_zenoh waits for ever."""
    kind = f"{ACTION}_GetResult"
    response = eventually(
        lambda: make_service_call(observe)(
            f"{UNDER}/get_result",
            kind,
            hash_of_service(kind),
            goal_id={"uuid": [number, *range(15)]},
        ),
        WITHIN_S,
        "a result",
    )
    return response["status"], response["error_code"]


def test_trajectory_of_a_ros_client_is_followed_with_feedback(
    trial: ArmTrial, observe: CallObserver
) -> None:
    observe("subscribe", topic=f"{UNDER}/feedback", kind=f"{ACTION}_FeedbackMessage", qos="")

    sent = send(observe, 1, positions=[0.5, -0.8], time_from_start={"sec": 1, "nanosec": 0})
    result = find_result(observe, 1)

    assert sent["accepted"]
    assert result == (SUCCEEDED, 0)
    trial.wait_for("shoulder", 0, 0.5, 0.02)
    trial.wait_for("elbow", 0, -0.8, 0.02)
    eventually(
        lambda: len(observe("received", topic=f"{UNDER}/feedback")) >= 10, WITHIN_S, "feedback"
    )


def test_trajectory_is_canceled(observe: CallObserver) -> None:
    sent = send(observe, 2, positions=[-1.0, 1.0], time_from_start={"sec": 60, "nanosec": 0})
    assert sent["accepted"]
    kind = "action_msgs/srv/CancelGoal"
    info = {"goal_id": {"uuid": [2, *range(15)]}}
    canceled = make_service_call(observe)(
        f"{UNDER}/cancel_goal", kind, hash_of_service(kind), goal_info=info
    )

    assert canceled is not None
    assert canceled["return_code"] == 0
    assert find_result(observe, 2)[0] == CANCELED


def test_goal_with_too_few_positions_is_refused(observe: CallObserver) -> None:
    sent = send(observe, 3, positions=[0.5], time_from_start={"sec": 1, "nanosec": 0})

    assert not sent["accepted"]
