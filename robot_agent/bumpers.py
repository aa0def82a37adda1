"""Contact sensors of robots: contacts of the server as messages of Gazebo's bumper."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from zensim.proto import keys
from zensim.proto.codec import cdr, cdr_template
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.message_paths import HEADER_STAMP
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.gazebo_messages import ContactsState, ContactState
from zensim.proto.messages.model_messages import Sensor, Vec3
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.sensor_messages import ContactSensor
from zensim.proto.messages.standard_messages import Header, Vector3, Wrench, time_from_ns
from zensim.proto.sensor_schedule import is_due
from zensim.proto.topic_catalog import BUMPER_STATES
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory

SCOPE_SEPARATOR = "::"
BODIES_STRUCT, POINTS_STRUCT = struct.Struct("<4I"), struct.Struct("<10d")


@dataclass(frozen=True)
class Touch:
    """A point at which a collision of a robot touches something; vectors are in the world."""

    link: int
    collision: int
    other: str
    position: Vec3
    normal: Vec3
    depth_m: float
    force: Vec3


@dataclass(frozen=True)
class ContactReport:
    """The contacts of one control step, by entity."""

    step: int
    time_ns: int
    touches: Mapping[str, list[Touch]]


def read_contact_report(contacts: Contacts) -> ContactReport:
    """Unpack contacts.

    Raises:
        MalformedPayload: Arrays do not fit together.
    """
    touches: dict[str, list[Touch]] = {}
    try:
        bodies = list(BODIES_STRUCT.iter_unpack(contacts.bodies))
        points = list(POINTS_STRUCT.iter_unpack(contacts.points))
        for (entity, link, collision, other), numbers in zip(bodies, points, strict=True):
            x, y, z, nx, ny, nz, depth_m, fx, fy, fz = numbers
            touch = Touch(
                link,
                collision,
                contacts.collisions[other],
                position=(x, y, z),
                normal=(nx, ny, nz),
                depth_m=depth_m,
                force=(fx, fy, fz),
            )
            touches.setdefault(contacts.entities[entity], []).append(touch)
    except (struct.error, IndexError, ValueError) as error:
        raise MalformedPayload(f"the arrays of contacts do not fit together: {error}") from error
    return ContactReport(contacts.step, contacts.time_ns, touches)


class Bumper:
    """One contact sensor of one robot."""

    def __init__(self, claim: Claim, sensor: Sensor, settings: ContactSensor) -> None:
        self.key = keys.robot(claim.namespace, sensor.topics[0].name)
        self._entity = claim.entity
        self._environment = claim.environment
        self._rate_hz = sensor.update_rate_hz
        self._frame_id = sensor.frame_id
        self._names = {
            place: f"{claim.entity}{SCOPE_SEPARATOR}{name}"
            for place, name in zip(settings.collisions, settings.names, strict=True)
        }
        self._seen_step: int | None = None
        self._payload: bytes | None = None
        # Most robots touch nothing most of the time.
        self._untouched = cdr_template.CdrTemplate(
            self._make_message(0, []), numbers=(), stamps=HEADER_STAMP
        )

    def reset(self) -> None:
        """Forget the last message; time may have gone back."""
        self._seen_step = self._payload = None

    def take(self, report: ContactReport) -> bytes | None:
        """Take the contacts of a step; return the message if it is due."""
        seen = self._seen_step
        if seen is not None and report.step < seen:
            seen = None
        self._seen_step = report.step
        if not is_due(report.step, self._rate_hz, self._environment, seen):
            return None
        touches = [
            touch
            for touch in report.touches.get(self._entity, ())
            if (touch.link, touch.collision) in self._names
        ]
        if touches:
            self._payload = cdr.encode(self._make_message(report.time_ns, touches))
        else:
            self._payload = self._untouched.payload(report.time_ns, ())
        return self._payload

    def payload(self, row: int = 0) -> bytes | None:  # noqa: ARG002 - of the protocol
        """Return the last message; see `LastValues`."""
        return self._payload

    def _make_message(self, time_ns: int, touches: list[Touch]) -> ContactsState:
        pairs: dict[tuple[str, str], list[Touch]] = {}
        for touch in touches:
            own = self._names[touch.link, touch.collision]
            pairs.setdefault((own, touch.other), []).append(touch)
        return ContactsState(
            Header(time_from_ns(time_ns), self._frame_id),
            tuple(_make_contact_state(*pair, found) for pair, found in pairs.items()),
        )


def _make_contact_state(own: str, other: str, touches: list[Touch]) -> ContactState:
    forces = [touch.force for touch in touches]
    total = Vector3(*(sum(axis) for axis in zip(*forces, strict=True)))
    return ContactState(
        collision1_name=own,
        collision2_name=other,
        wrenches=tuple(Wrench(Vector3(*force)) for force in forces),
        total_wrench=Wrench(total),
        contact_positions=tuple(Vector3(*touch.position) for touch in touches),
        contact_normals=tuple(Vector3(*touch.normal) for touch in touches),
        depths=tuple(touch.depth_m for touch in touches),
    )


def make_bumpers(claim: Claim) -> list[Bumper]:
    """Make the contact sensors of a robot."""
    return [
        Bumper(claim, sensor, sensor.settings)
        for sensor in claim.model.sensors
        if isinstance(sensor.settings, ContactSensor) and sensor.topics
    ]


class BumperTelemetry:
    """The contact sensors of one robot, and their topics."""

    def __init__(self, factory: TopicFactory, claim: Claim) -> None:
        self._bumpers = make_bumpers(claim)
        self.publishers = [
            LazyTopicPublisher(factory, BUMPER_STATES.at(bumper.key), bumper.payload)
            for bumper in self._bumpers
        ]

    @property
    def is_wanted(self) -> bool:
        """Whether any of them has a subscriber."""
        return any(publisher.is_matched for publisher in self.publishers)

    def reset(self) -> None:
        """Forget the last messages; time may have gone back."""
        for bumper in self._bumpers:
            bumper.reset()

    def publish(self, report: ContactReport) -> None:
        """Publish what is due."""
        for bumper, publisher in zip(self._bumpers, self.publishers, strict=True):
            if bumper.take(report) is not None:
                publisher.publish()
