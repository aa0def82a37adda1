"""True odometry of a link, told as Gazebo's p3d plug-in tells it."""

from random import Random

from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import ZERO, GroundTruth, Model, Quat, Vec3
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
    time_from_ns,
)
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.kinematics import Chain, LinkMotion, scaled
from zensim.robot_agent.outlet import Outlet
from zensim.robot_agent.rate_gate import RateGate
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.remapping import topic_key
from zensim.robot_agent.transforms import add, multiply, rotate

QUIET = (ZERO, ZERO)


class TruthTelemetry:
    """What the ground truth plug-ins of one robot tell, each at a rate of its own."""

    def __init__(self, faces: TopicFactory, claim: Claim) -> None:
        self._truths = tuple(
            Truth(claim.model, wish, f"{claim.entity}/{number}")
            for number, wish in enumerate(claim.model.ground_truths)
        )
        self.outlets = [
            Outlet(
                faces,
                Topic(topic_key(claim.namespace, truth.wish.topic, truth.wish.ros), Odometry),
                truth.message,
            )
            for truth in self._truths
        ]

    def reset(self) -> None:
        """Start again; time may have gone back."""
        for truth in self._truths:
            truth.reset()

    def tell(self, reading: Reading) -> None:
        """Tell what is due."""
        for truth, outlet in zip(self._truths, self.outlets, strict=True):
            if truth.take(reading):
                outlet.publish()


class Truth:
    """The true motion of one link, with the noise that was asked for.

    The noise is drawn from a seed of its own, so that it is the same on every run and after every
    reset.
    """

    def __init__(self, model: Model, wish: GroundTruth, seed: str) -> None:
        links = {link.name for link in model.links} | {frame.name for frame in model.frames}
        self.wish = wish
        self._body = Chain(model, wish.body)
        self._frame = Chain(model, wish.frame_id) if wish.frame_id in links else None
        self._gate = RateGate(wish.update_rate_hz)
        self._seed = seed
        self._random = Random(seed)
        self._reading: Reading | None = None
        self._noise = QUIET
        variance = wish.noise * wish.noise
        self._covariance = tuple(0.0 if place % 7 else variance for place in range(36))

    def reset(self) -> None:
        """Start again."""
        self._gate.reset()
        self._random = Random(self._seed)
        self._reading = None

    def take(self, reading: Reading) -> bool:
        """Take a reading; tell whether it was due."""
        if self._gate.elapsed_s(reading.time_ns) is None:
            return False
        self._reading = reading
        if self.wish.noise:
            self._noise = (self._draw(), self._draw())
        return True

    def message(self) -> Odometry | None:
        """Write the last reading down; None while there is none."""
        if (reading := self._reading) is None:
            return None
        motion = self._motion(reading)
        pose = Pose(Point(*motion.position), Quaternion(*motion.orientation))
        twist = Twist(
            Vector3(*add(motion.linear, self._noise[0])),
            Vector3(*add(motion.angular, self._noise[1])),
        )
        return Odometry(
            Header(time_from_ns(reading.time_ns), self.wish.frame_id),
            self.wish.body,
            PoseWithCovariance(pose, self._covariance),
            TwistWithCovariance(twist, self._covariance),
        )

    def _draw(self) -> Vec3:
        spread, draw = self.wish.noise, self._random.gauss
        return (draw(0.0, spread), draw(0.0, spread), draw(0.0, spread))

    def _motion(self, reading: Reading) -> LinkMotion:
        motion = self._body.motion(reading)
        if self._frame is not None:
            motion = _seen_from(self._frame.motion(reading), motion)
        linear, angular = motion.linear, motion.angular
        if self.wish.compat != "gazebo11":
            back = _inverse(motion.orientation)
            linear, angular = rotate(back, linear), rotate(back, angular)
        offset = self.wish.offset
        return LinkMotion(
            add(motion.position, offset.position),
            multiply(offset.orientation, motion.orientation),
            linear,
            angular,
        )


def _seen_from(frame: LinkMotion, body: LinkMotion) -> LinkMotion:
    back = _inverse(frame.orientation)

    def difference(one: Vec3, other: Vec3) -> Vec3:
        return rotate(back, add(one, scaled(other, -1.0)))

    return LinkMotion(
        difference(body.position, frame.position),
        multiply(back, body.orientation),
        difference(body.linear, frame.linear),
        difference(body.angular, frame.angular),
    )


def _inverse(orientation: Quat) -> Quat:
    x, y, z, w = orientation
    return (-x, -y, -z, w)
