"""Handles of one robot or entity of a simulation, by name."""

from collections.abc import Callable, Sequence
from typing import Any

from zensim.api.api_errors import Invalid, refuse_pickling
from zensim.api.argument_checks import MAX_NUMBER, check_limits, check_range, make_numbers
from zensim.api.entity_values import RobotPose, RobotTwist, SpawnReport
from zensim.api.topic import Topic, TopicCallback
from zensim.api.world_access import api_errors
from zensim.api.world_session import MAX_RUN_S, RELEASED, WorldSession
from zensim.api.world_state import POSE
from zensim.proto.messages.drive_messages import name_drive
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import JointState, Odometry
from zensim.proto.path_following import PathController
from zensim.spawner.spawn.spawn_poses import make_pose

MIN_SPEED = 1e-6
"""Least speed along a path [m/s]."""


class EntityHandle:
    """An entity of a simulation; properties are those of the newest state."""

    def __init__(self, session: WorldSession, name: str, report: SpawnReport | None = None) -> None:
        self._session = session
        self._name = name
        self._report = report

    @property
    def name(self) -> str:
        """Name, unique in the world."""
        return self._name

    @property
    def namespace(self) -> str:
        """Prefix of its topics and frames."""
        return self._session.find_entry(self._name).namespace

    @property
    def exists(self) -> bool:
        """Whether it has not been deleted."""
        return self._name in self._session.state().row

    @property
    def pose(self) -> RobotPose:
        """Pose of the root link in the world: [m], quaternion x y z w.

        Raises:
            NotFound: It was deleted.
        """
        state, row = self._session.find_row(self._name)
        return RobotPose(*state.base[row, POSE].tolist())

    @property
    def twist(self) -> RobotTwist:
        """Twist of the root link in its own frame: [m/s] and [rad/s].

        Raises:
            NotFound: It was deleted.
        """
        state, row = self._session.find_row(self._name)
        return RobotTwist(*state.twists[row].tolist())

    @property
    def report(self) -> SpawnReport:
        """What became of its description."""
        if self._report is None:
            entry = self._session.find_entry(self._name)
            self._report = SpawnReport(
                self._name, entry.namespace, entry.model.report, drive=name_drive(entry.model.drive)
            )
        return self._report

    def set_pose(self, x: float, y: float, z: float | None = None, *, yaw: float = 0.0) -> None:
        """Place it at rest in the world; `z` [m] stays as it is if it is not given."""
        self._session.check_open()
        height = self.pose.z if z is None else z
        numbers = make_numbers("pose", [[x, y, height, yaw]], "(x, y, z, yaw)")
        check_limits("pose", numbers, "(x, y, z, yaw)")
        state = EntityState(pose=make_pose((x, y, height), (0.0, 0.0, yaw)))
        with api_errors():
            self._session.client.set_entity_state(self._name, state)
        self._session.access.refresh()

    def delete(self) -> None:
        """Delete it."""
        self._session.check_open()
        with api_errors():
            self._session.client.delete(self._name)
        self._session.access.refresh()

    def __repr__(self) -> str:
        """Write class and name."""
        return f"{type(self).__name__}({self._name!r})"

    def __reduce__(self) -> tuple[object, ...]:
        """Refuse: a handle belongs to its process."""
        refuse_pickling(self, "pass sim.endpoint and the name")


class Robot(EntityHandle):
    """An entity with a drive."""

    @property
    def agent(self) -> str:
        """Name of the agent that drives it; empty if none does."""
        return self._session.find_entry(self._name).agent

    @property
    def odom(self) -> Odometry:
        """Newest odometry, as on its topic."""
        topic: Topic[Odometry] = self._topic_of("odom")
        return topic.newest()

    @property
    def joints(self) -> JointState:
        """Newest joint states, as on their topic; fields of numbers are arrays.

        Efforts are NaN until the first message after a step, with which the engine finds them,
        and always for kinematic robots.
        """
        topic: Topic[JointState] = self._topic_of("joint_states")
        return topic.newest()

    @property
    def sensors(self) -> dict[str, "Topic[Any]"]:
        """Topics of its sensors, by name of the sensor; `settings` are those of the sensor."""
        entry = self._session.find_entry(self._name)
        found = {}
        for sensor in entry.model.sensors:
            if sensor.topics:
                topic = self._topic_of(sensor.topics[0].name)
                topic.settings = sensor
                found[sensor.name] = topic
        return found

    def drive(
        self, v: float = 0.0, w: float = 0.0, *, left: float = 0.0, seconds: float | None = None
    ) -> None:
        """Order a twist, which holds until the next order or `stop`.

        Args:
            v: Forward velocity [m/s].
            w: Angular velocity [rad/s], positive to the left.
            left: Velocity to the left [m/s], for robots that can move sideways.
            seconds: Drive for this simulation time, then stop; returns when it is over.
        """
        self._session.check_open()
        twist = make_numbers("v, left and w", [[v, left, w]], "(v, left, w)")
        if twist.shape != (1, 3):
            raise Invalid("v, left and w are not numbers", slug="wrong_shape", hint="give numbers")
        check_limits("twist", twist, "(v, left, w)")
        if seconds is not None:
            check_range("seconds", seconds, 0.0, MAX_RUN_S)
        self._session.find_row(self._name)
        self._session.order((self._name,), twist)
        if seconds is not None:
            self._session.run(seconds)
            self.stop()

    def stop(self) -> None:
        """Order a twist of zero."""
        self.drive(0.0, 0.0)

    def release(self) -> None:
        """End the order, so that only `cmd_vel` counts."""
        self._session.check_open()
        self._session.order((self._name,), RELEASED[None])

    def follow(self, points: Sequence[tuple[float, float]], speed: float = 0.3) -> None:
        """Drive along points of the world in straight lines, and stop at the last.

        It goes on while time advances, until the next call of `drive`, `stop` or `follow`.

        Args:
            points: x and y [m].
            speed: [m/s], > 0.
        """
        path = make_numbers("points", points, "(n, 2): x and y")
        if path.ndim != 2 or path.shape[1:] != (2,) or not len(path):  # noqa: PLR2004  x and y
            raise Invalid(
                f"points have shape {path.shape}", slug="wrong_shape", hint="give (n, 2): x and y"
            )
        check_limits("points", path, "(n, 2)")
        check_range("speed", speed, MIN_SPEED, MAX_NUMBER)
        self._session.follow_path(self._name, PathController(path, speed))

    def topic(self, name: str) -> "Topic[Any]":
        """Find a topic by its name below the namespace, as `scan`, `odom` or `front/scan`.

        Raises:
            NotFound: The robot has no such topic.
        """
        return self._topic_of(name)

    def on(
        self, topic: str, queue: int = 1
    ) -> Callable[[Callable[[Any], object]], TopicCallback[Any]]:
        """Decorate a function that is called with the messages of a topic; see `Topic.on`."""

        def subscribe(call: Callable[[Any], object]) -> TopicCallback[Any]:
            return self._topic_of(topic).on(call, queue)

        return subscribe

    def _topic_of(self, name: str) -> "Topic[Any]":
        return self._session.find_robot_topic(self._name, name)
