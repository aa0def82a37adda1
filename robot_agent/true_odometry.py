"""True odometry of a link, as Gazebo's p3d plug-in publishes it."""

from random import Random

from zensim.proto.drive_topic_keys import resolve_topic_key
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import ZERO, GroundTruth, Model, Vec3
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
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.rigid_transforms import add, conjugate, multiply, rotate, scale
from zensim.proto.ros2.ros_graph import RosTopic
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.link_motion import LinkChain, LinkState, find_link_chain

NO_NOISE = (ZERO, ZERO)


class TrueOdometryTelemetry:
    """True odometry topics of one robot, each at its own rate."""

    def __init__(self, factory: TopicFactory, claim: Claim) -> None:
        self._odometries = tuple(
            TrueOdometry(claim.model, settings, f"{claim.entity}/{number}")
            for number, settings in enumerate(claim.model.ground_truths)
        )
        self.publishers = [
            LazyTopicPublisher(
                factory,
                RosTopic(
                    resolve_topic_key(
                        claim.namespace, odometry.settings.topic, odometry.settings.ros
                    ),
                    Odometry,
                ),
                odometry.message,
            )
            for odometry in self._odometries
        ]

    def reset(self) -> None:
        """Reset all; time may have gone back."""
        for odometry in self._odometries:
            odometry.reset()

    def publish(self, state: RobotState) -> None:
        """Publish what is due."""
        for odometry, publisher in zip(self._odometries, self.publishers, strict=True):
            if odometry.take(state):
                publisher.publish()


class TrueOdometry:
    """The true motion of one link, with noise.

    The noise has its own seed, so that it is equal in every run and after every reset.
    """

    def __init__(self, model: Model, settings: GroundTruth, seed: str) -> None:
        links = {link.name for link in model.links} | {frame.name for frame in model.frames}
        self.settings = settings
        self._body = find_link_chain(model, settings.body)
        self._frame = (
            find_link_chain(model, settings.frame_id) if settings.frame_id in links else None
        )
        self._limiter = RateLimiter(settings.update_rate_hz)
        self._seed = seed
        self._random = Random(seed)
        self._state: RobotState | None = None
        self._noise = NO_NOISE
        variance = settings.noise * settings.noise
        self._covariance = tuple(0.0 if place % 7 else variance for place in range(36))

    def reset(self) -> None:
        """Reset noise and rate."""
        self._limiter.reset()
        self._random = Random(self._seed)
        self._state = None

    def take(self, state: RobotState) -> bool:
        """Take a state; return whether it was due."""
        if self._limiter.elapsed_s(state.time_ns) is None:
            return False
        self._state = state
        if self.settings.noise:
            self._noise = (self._draw_noise(), self._draw_noise())
        return True

    def message(self) -> Odometry | None:
        """Make the message of the last state; None if there is none."""
        if (state := self._state) is None:
            return None
        motion = self._motion(state)
        pose = Pose(Point(*motion.position), Quaternion(*motion.orientation))
        twist = Twist(
            Vector3(*add(motion.linear, self._noise[0])),
            Vector3(*add(motion.angular, self._noise[1])),
        )
        return Odometry(
            Header(time_from_ns(state.time_ns), self.settings.frame_id),
            self.settings.body,
            PoseWithCovariance(pose, self._covariance),
            TwistWithCovariance(twist, self._covariance),
        )

    def _draw_noise(self) -> Vec3:
        spread, draw = self.settings.noise, self._random.gauss
        return (draw(0.0, spread), draw(0.0, spread), draw(0.0, spread))

    def _motion(self, state: RobotState) -> LinkState[float]:
        motion = _find_motion(self._body, state)
        if self._frame is not None:
            motion = _make_relative(_find_motion(self._frame, state), motion)
        linear, angular = motion.linear, motion.angular
        if self.settings.compat != "gazebo11":
            back = conjugate(motion.orientation)
            linear, angular = rotate(back, linear), rotate(back, angular)
        offset = self.settings.offset
        return LinkState(
            add(motion.position, offset.position),
            multiply(offset.orientation, motion.orientation),
            linear,
            angular,
        )


def _find_motion(chain: LinkChain, state: RobotState) -> LinkState[float]:
    return chain.motion(state.base, state.positions, state.velocities, FLOAT_MATH)


def _make_relative(frame: LinkState[float], body: LinkState[float]) -> LinkState[float]:
    back = conjugate(frame.orientation)

    def difference(one: Vec3, other: Vec3) -> Vec3:
        return rotate(back, add(one, scale(other, -1.0)))

    return LinkState(
        difference(body.position, frame.position),
        multiply(back, body.orientation),
        difference(body.linear, frame.linear),
        difference(body.angular, frame.angular),
    )
