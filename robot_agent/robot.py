"""One claimed robot: what it hears, how it is driven, what it tells."""

from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.standard_messages import Twist, TwistStamped
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.cmd_vel import DEPTH, STILL, CommandedTwist
from zensim.robot_agent.driven_base import DrivenBase, drive_of
from zensim.robot_agent.ground_truth import TruthTelemetry
from zensim.robot_agent.outlet import Outlet
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.remapping import command_key
from zensim.robot_agent.telemetry import JointTelemetry, MotionTelemetry, constant_outlets

NODE = "agent"
"""What a robot's node is called in ROS 2, within the robot's namespace."""


class Robot:
    """Turns readings into targets, then into telemetry; without a drive, only the latter."""

    def __init__(self, faces: TopicFactory, claim: Claim, cmd_vel_timeout_ns: int) -> None:
        self.entity = claim.entity
        self._faces = faces
        self.joint_count = len(claim.model.joints)
        self.target_count = claim.model.target_count
        self.commanded: CommandedTwist | None = None
        """None without a drive: there is nothing to command."""
        self._base = DrivenBase(claim.model)
        self._motion = MotionTelemetry(faces, claim)
        self._joints = JointTelemetry(faces, claim)
        self._truth = TruthTelemetry(faces, claim)
        self._constant = constant_outlets(faces, claim)
        self._reading: Reading | None = None
        self._is_motion_new = False
        if claim.model.drive is not None:
            key = command_key(claim.namespace, drive_of(claim.model))
            heard = faces.subscription(key, (Twist, TwistStamped), DEPTH)
            self.commanded = CommandedTwist(heard, cmd_vel_timeout_ns)

    def reset(self) -> None:
        """Start again at a reset of the world: stand, forget, let time go back."""
        self._base.reset()
        self._motion.reset()
        self._joints.reset()
        self._truth.reset()
        if self.commanded is not None:
            self.commanded.reset()

    def advance(self, reading: Reading) -> tuple[float, ...]:
        """Take a reading and find the numbers for `Model.actuators`."""
        twist = self.commanded.at(reading.time_ns) if self.commanded else STILL
        self._reading = reading
        self._is_motion_new = self._base.update(reading, twist)
        return self._base.targets

    @property
    def targets(self) -> tuple[float, ...]:
        """Numbers for `Model.actuators`, as of the last reading."""
        return self._base.targets

    def revise(self) -> bool:
        """Heed a new twist as if it had come before the last reading; tell whether one did."""
        if self.commanded is None or self._reading is None:
            return False
        before = self.commanded.twist
        twist = self.commanded.at(self._reading.time_ns)
        return twist != before and self._base.revise(twist)

    def tell(self) -> None:
        """Publish what the last reading made due."""
        if self._reading is None:
            return
        if self._is_motion_new:
            self._motion.tell(self._reading, self._base.motion)
        self._joints.tell(self._reading)
        self._truth.tell(self._reading)

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""
        for outlet in self._constant:
            outlet.announce()

    def answer(self) -> None:
        """Tell last values to those who have asked."""
        for outlet in self._outlets():
            outlet.answer()

    def close(self) -> None:
        """Withdraw everything."""
        for outlet in self._outlets():
            outlet.close()
        if self.commanded is not None:
            self.commanded.close()
        self._faces.close()

    def _outlets(self) -> list[Outlet]:
        return [
            *self._motion.outlets,
            *self._joints.outlets,
            *self._truth.outlets,
            *self._constant,
        ]
