"""JointControl: commands and trajectories of the joints of one robot, as targets of its motors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

from zensim.proto import keys
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import JointController, Model
from zensim.proto.network_protocols import MAX_COMMAND_BYTES, Sample
from zensim.proto.ros2.action_server import ActionGoals, MergedQueries, serve_action
from zensim.proto.ros2.trajectory_messages import FOLLOW_JOINT_TRAJECTORY, TRAJECTORY_ACTION
from zensim.proto.topic_catalog import CONTROLLER_COMMANDS, JOINT_COMMANDS
from zensim.proto.topic_endpoints import (
    TopicFactory,
    TopicPublisher,
    TopicSubscription,
    advertise_action,
)
from zensim.robot_agent.joint_commands import (
    FREE,
    JointCommand,
    JointTarget,
    RefusedCommand,
    decode_joint_command,
    list_commands,
    list_joint_limits,
)
from zensim.robot_agent.joint_trajectory import JointsState
from zensim.robot_agent.topic_remapping import find_topic_keys
from zensim.robot_agent.trajectory_follower import TrajectoryFollower

COMMANDS_DEPTH: Final = 16
"""Several clients may command several joints between two states."""
EXPIRING: Final = (JointTargetKind.VELOCITY, JointTargetKind.EFFORT)
"""Kinds of targets that need to be repeated; a position holds."""
UNLIMITED: Final = (-math.inf, math.inf)
ReadStates = Callable[[], tuple[Sequence[float], Sequence[float]]]
"""Reads positions and velocities of all joints, in the order of `Model.joints`."""


@dataclass
class _Commands:
    """Commands on one topic: of any joint, or of those of a controller."""

    subscription: TopicSubscription
    controller: JointController


@dataclass(frozen=True)
class _Action:
    """Endpoints of an action."""

    queues: tuple[MergedQueries, ...]
    publishers: tuple[TopicPublisher, ...]

    def close(self) -> None:
        """Undeclare them."""
        for queue in self.queues:
            queue.close()
        for publisher in self.publishers:
            publisher.close()


class JointControl:
    """The joints of one robot that its controllers command."""

    def __init__(self, factory: TopicFactory, claim: Claim, timeout_ns: int) -> None:
        """Declare topics and actions.

        Args:
            factory: Declares topics and services; without a ROS 2 node there are no actions.
            claim: The robot.
            timeout_ns: Simulation time for which a velocity or an effort is valid; 0 = for ever.
        """
        model = claim.model
        self.malformed = 0
        """Number of messages or commands that were refused."""
        self._reported = 0
        self._fault = ""
        self._timeout_ns = timeout_ns
        self._limits = list_joint_limits(model)
        self._places = {joint.name: i for i, joint in enumerate(model.joints)}
        self._start = _list_start_targets(model)
        self._targets = _read_targets(claim, self._start)
        self._packed: tuple[float, ...] | None = None
        """The same as numbers; None after a change."""
        self._received_ns: dict[str, int] = {}
        self._commands = _subscribe(factory, claim)
        self._actions: list[_Action] = []
        self._followers: list[TrajectoryFollower] = []
        if factory.node is not None:
            self._declare_actions(factory, claim)

    @property
    def targets(self) -> tuple[float, ...]:
        """Targets of `Model.joint_actuators`: a kind and a number for each."""
        if self._packed is None:
            self._packed = tuple(chain.from_iterable(self._targets.values()))
        return self._packed

    def reset(self) -> None:
        """Start again at a reset of the world; messages that wait still count."""
        self._targets = dict(self._start)
        self._received_ns.clear()
        self._packed = None
        for follower in self._followers:
            follower.abort("the world was reset")

    def update(self, time_ns: int, read: ReadStates) -> tuple[float, ...]:
        """Take commands and goals; return the targets.

        Args:
            time_ns: Simulation time.
            read: Called only while there is a trajectory.
        """
        for commands in self._commands:
            for sample in commands.subscription.take():
                self._apply(sample, commands.controller, time_ns)
        for follower in self._followers:
            before = follower.joints
            follower.update(time_ns, lambda names: self._select(read, names), self._move)
            if follower.joints and follower.joints is not before:
                self._abort_others(follower)
        if self._timeout_ns and self._received_ns:
            self._expire(time_ns)
        return self.targets

    def take_malformed_report(self) -> str:
        """Describe what was refused since the last call; empty if nothing was."""
        if self.malformed == self._reported:
            return ""
        self._reported = self.malformed
        return f"malformed={self.malformed} reason={self._fault!r}"

    def close(self) -> None:
        """End the goals, and undeclare topics and actions."""
        for follower in self._followers:
            follower.abort("the robot is gone")
        for commands in self._commands:
            commands.subscription.close()
        for action in self._actions:
            action.close()

    def _declare_actions(self, factory: TopicFactory, claim: Claim) -> None:
        turning = frozenset(one.name for one in claim.model.joints if one.kind == "continuous")
        for controller in claim.model.joint_controllers:
            if controller.follows_trajectories:
                action = _declare_action(factory, claim.namespace, controller.name)
                goals = ActionGoals(FOLLOW_JOINT_TRAJECTORY, action.queues, action.publishers)
                self._actions.append(action)
                self._followers.append(TrajectoryFollower(controller, goals, turning))

    def _abort_others(self, started: TrajectoryFollower) -> None:
        """Abort the goals of other controllers with joints of a new goal."""
        for follower in self._followers:
            if follower is not started and not set(started.joints).isdisjoint(follower.joints):
                follower.abort(f"controller '{started.name}' has taken its joints")

    def _apply(self, sample: Sample, controller: JointController, time_ns: int) -> None:
        try:
            message = decode_joint_command(sample.payload, sample.encoding)
            commands = list(list_commands(message, controller.joints, controller.interface))
        except MalformedPayload as error:
            self._note_refused(str(error))
            return
        followed = {name for follower in self._followers for name in follower.joints}
        for command in commands:
            self._try_command(command, followed, time_ns)

    def _try_command(self, command: JointCommand, followed: set[str], time_ns: int) -> None:
        try:
            self._command(command, followed, time_ns)
        except RefusedCommand as error:
            self._note_refused(str(error))

    def _command(self, command: JointCommand, followed: set[str], time_ns: int) -> None:
        joint = command.joint
        if (limits := self._limits.get(joint)) is None:
            raise RefusedCommand(
                f"no controller has joint '{joint[:80]}'; there are {', '.join(self._limits)}"
            )
        if joint in followed:
            raise RefusedCommand(f"joint '{joint}' follows a trajectory; cancel its goal first")
        self._set(joint, limits.limit(command.target))
        self._received_ns[joint] = time_ns

    def _note_refused(self, reason: str) -> None:
        self.malformed += 1
        self._fault = reason

    def _expire(self, time_ns: int) -> None:
        """Stop joints whose velocity or effort was not repeated in time."""
        for joint, received_ns in tuple(self._received_ns.items()):
            if time_ns - received_ns <= self._timeout_ns:
                continue
            kind = self._targets[joint].kind
            if kind in EXPIRING:
                self._set(joint, JointTarget(kind, 0.0))
            del self._received_ns[joint]

    def _set(self, joint: str, target: JointTarget) -> None:
        if self._targets[joint] != target:
            self._targets[joint], self._packed = target, None

    def _select(self, read: ReadStates, names: Sequence[str]) -> JointsState:
        positions, velocities = read()
        places = [self._places[name] for name in names]
        return JointsState(
            tuple(positions[place] for place in places),
            tuple(velocities[place] for place in places),
        )

    def _move(self, names: Sequence[str], positions: Sequence[float]) -> None:
        for name, position in zip(names, positions, strict=True):
            least, most = self._limits[name].bounds.get(JointTargetKind.POSITION, UNLIMITED)
            limited = min(max(position, least), most)
            self._set(name, JointTarget(JointTargetKind.POSITION, limited))
            self._received_ns.pop(name, None)


def make_joint_control(factory: TopicFactory, claim: Claim, timeout_ns: int) -> JointControl | None:
    """Make the control of a robot's joints, see `JointControl`; None without controllers."""
    return JointControl(factory, claim, timeout_ns) if claim.model.joint_controllers else None


def _list_start_targets(model: Model) -> dict[str, JointTarget]:
    """List the targets at the start, in the order of `Model.joint_actuators`."""
    held = {name for one in model.joint_controllers if one.holds for name in one.joints}
    initial = {one.joint: one.initial for one in model.command_interfaces}
    return {
        one.joint: JointTarget(JointTargetKind.POSITION, initial.get(one.joint) or 0.0)
        if one.joint in held
        else FREE
        for one in model.joint_actuators
    }


def _read_targets(claim: Claim, start: dict[str, JointTarget]) -> dict[str, JointTarget]:
    """Find the targets to go on with: another agent may have moved the joints before."""
    numbers = claim.joint_targets
    if len(numbers) != 2 * len(start):
        return dict(start)
    pairs = zip(numbers[::2], numbers[1::2], strict=True)
    return {
        name: JointTarget(JointTargetKind(int(kind)), number)
        for name, (kind, number) in zip(start, pairs, strict=True)
    }


def _subscribe(factory: TopicFactory, claim: Claim) -> list[_Commands]:
    """Subscribe to commands of any joint, and of the joints of controllers without trajectories."""
    controllers = claim.model.joint_controllers
    found = [
        _Commands(
            factory.subscription(
                find_topic_keys(claim).joint_commands,
                JOINT_COMMANDS.messages,
                COMMANDS_DEPTH,
                MAX_COMMAND_BYTES,
                name=JOINT_COMMANDS.name,
            ),
            controllers[0],
        )
    ]
    for controller in controllers:
        if not controller.follows_trajectories:
            key = f"{keys.robot(claim.namespace, controller.name)}/{CONTROLLER_COMMANDS.suffix}"
            subscription = factory.subscription(
                key,
                CONTROLLER_COMMANDS.messages,
                COMMANDS_DEPTH,
                MAX_COMMAND_BYTES,
                name=CONTROLLER_COMMANDS.name,
            )
            found.append(_Commands(subscription, controller))
    return found


def _declare_action(factory: TopicFactory, namespace: str, controller: str) -> _Action:
    assert factory.node is not None
    name = f"{keys.robot(namespace, controller)}/{TRAJECTORY_ACTION}"
    queues = serve_action(factory.serve, factory.node, name, FOLLOW_JOINT_TRAJECTORY)
    publishers = advertise_action(factory, name, FOLLOW_JOINT_TRAJECTORY)
    return _Action(tuple(queues.values()), tuple(publishers.values()))
