"""What clients may change with `--allow-control`: commands of robots, services, parameters."""

from typing import Final, cast

import msgspec

from zensim.foxglove.foxglove_protocol import (
    CONTROL_ENCODINGS,
    ROS_SCHEMA,
    AdvertisedService,
    ClientChannel,
    MessageForm,
    ServiceCallRequest,
    WorldParameter,
)
from zensim.proto import keys, service_catalog
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus, BusPublisher
from zensim.proto.codec.cdr_layout import find_ros_class
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import SetSpeedRequest
from zensim.proto.messages.telemetry_messages import Info, InfoRequest
from zensim.proto.ros2.message_definitions import write_definition
from zensim.proto.ros2.ros_service_catalog import ROS_SERVICES
from zensim.proto.security.roles import ROLES, Operation, User, list_keys
from zensim.proto.topic_catalog import CMD_VEL, Participant, find_robot_topic

CALL_TIMEOUT_S: Final = 10.0
SPEED_PARAMETER: Final = "real_time_factor"
"""Target of the simulation; 0 = as fast as possible."""
SERVICES: Final = (
    service_catalog.UNPAUSE_PHYSICS,
    service_catalog.PAUSE_PHYSICS,
    service_catalog.STEP_SIMULATION,
    service_catalog.RESET_SIMULATION,
    service_catalog.SET_SIMULATION_STATE,
    service_catalog.GET_SIMULATION_STATE,
    service_catalog.SPAWN_ENTITY,
    service_catalog.DELETE_ENTITY,
    service_catalog.GET_SPAWNABLES,
    service_catalog.GET_ENTITIES,
    service_catalog.GET_ENTITY_STATE,
    service_catalog.SET_ENTITY_STATE,
)
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload, ValueError)
"""Errors of a call; a client gets their texts."""


class RefusedChannel(ValueError):
    """A topic, type or encoding that clients cannot publish."""


class DriverChannel:
    """A topic that a client publishes."""

    def __init__(self, publisher: BusPublisher, kind: type[msgspec.Struct], encoding: str) -> None:
        self._publisher, self._kind = publisher, kind
        self._encoding = "application/json" if encoding == "json" else "application/cdr"
        self._stops_robot = False

    def publish(self, payload: bytes) -> None:
        """Publish a message as CDR.

        Raises:
            MalformedPayload: It is not of the type that was advertised.
        """
        message = decode(self._kind, payload, self._encoding)
        self._publisher.send(encode(message, Format.CDR))
        self._stops_robot = self._kind in CMD_VEL.messages

    def close(self) -> None:
        """Publish a stop if it has driven a robot, and end the publication."""
        if self._stops_robot:
            self._publisher.send(encode(self._kind(), Format.CDR))
        self._publisher.close()


class WorldControl:
    """Commands, services and parameters of one world; methods that call a service block."""

    def __init__(self, bus: Bus, world: str, domain: int | None) -> None:
        """Get the role of this session from a secured server.

        Raises:
            BusError: No server is running.
        """
        self._bus, self._world = bus, world
        self._publishable = self._list_publishable(domain) if bus.user else ["**"]
        """Key expressions: a router silently drops what a role does not permit."""
        by_name = {one.service: one for one in reversed(ROS_SERVICES)}
        self._services = dict(enumerate((by_name[one.name] for one in SERVICES), 1))

    def list_services(self) -> tuple[AdvertisedService, ...]:
        """List the services, with the definitions of their messages."""
        return tuple(
            AdvertisedService(
                number,
                ros.name,
                ros.ros_type,
                _describe_form(ros.request),
                _describe_form(ros.response),
            )
            for number, ros in self._services.items()
        )

    def call(self, request: ServiceCallRequest) -> bytes:
        """Call a service; return the response in the encoding of the request.

        Raises:
            ServiceError: The server refuses.
            BusError: No server is running.
            TimeoutError: It does not reply in time.
            MalformedPayload: The request is not of its type.
            ValueError: Service or encoding are unknown.
        """
        ros = self._services.get(request.service_id)
        if ros is None:
            known = ", ".join(map(str, self._services))
            raise ValueError(f"service {request.service_id} is unknown; the services are {known}")
        if request.encoding not in CONTROL_ENCODINGS:
            known = " or ".join(CONTROL_ENCODINGS)
            raise ValueError(f"encoding {request.encoding[:20]!r} is unknown; use {known}")
        service = service_catalog.SERVICES[ros.service]
        given = decode(ros.request, request.payload, f"application/{request.encoding}")
        response = self._bus.call(service, given, world=self._world, timeout_s=CALL_TIMEOUT_S)
        return encode(response, Format.JSON if request.encoding == "json" else Format.CDR)

    def open_publisher(self, channel: ClientChannel) -> DriverChannel:
        """Declare a topic that a client publishes.

        Raises:
            RefusedChannel: It is no command of a robot, or not of the right type; or the role of
                this session does not permit it.
        """
        key = channel.topic.strip("/")
        spec = find_robot_topic(key)
        if spec is None or spec.publisher is not Participant.USER or "*" in key or "/" not in key:
            raise RefusedChannel(
                f"{channel.topic[:80]!r} is no command of a robot; publish /ROBOT/cmd_vel or "
                "/ROBOT/joint_commands"
            )
        types = {str(vars(one)["ros_type"]): one for one in spec.messages}
        name = channel.schema_name  # some panels write pkg/Name
        kind = types.get(name.replace("/", "/msg/") if name.count("/") == 1 else name)
        if kind is None or channel.encoding not in CONTROL_ENCODINGS:
            raise RefusedChannel(
                f"{channel.topic} as {channel.schema_name[:80]!r} in {channel.encoding[:20]!r} is "
                f"unknown; use {' or '.join(types)} in {' or '.join(CONTROL_ENCODINGS)}"
            )
        if not any(keys.intersect(one, key) for one in self._publishable):
            raise RefusedChannel(f"the role of user '{self._bus.user}' may not publish {key}")
        publisher = self._bus.advertise(key, make_encoding(kind, Format.CDR))
        return DriverChannel(publisher, kind, channel.encoding)

    def read_parameters(self, names: tuple[str, ...]) -> tuple[WorldParameter, ...]:
        """Read the named parameters, or all.

        Raises:
            BusError: No server is running.
        """
        if names and SPEED_PARAMETER not in names:
            return ()
        value = self._read_info().target_real_time_factor
        return (WorldParameter(SPEED_PARAMETER, value, "float64"),)

    def set_parameters(self, parameters: tuple[WorldParameter, ...]) -> None:
        """Set parameters; all are checked first.

        Raises:
            ValueError: One is unknown, or its value is not valid.
            ServiceError: The server refuses.
            BusError: No server is running.
        """
        factors = [*map(_read_factor, parameters)]
        for factor in factors:
            self._bus.call(
                service_catalog.SET_SPEED,
                SetSpeedRequest(factor),
                world=self._world,
                timeout_s=CALL_TIMEOUT_S,
            )

    def _list_publishable(self, domain: int | None) -> list[str]:
        role = self._read_info().role
        if role not in ROLES:
            return []
        user = User(self._bus.user, role)
        return list_keys(user, Operation.PUBLISH, world=self._world, domain=domain)

    def _read_info(self) -> Info:
        return self._bus.call(
            service_catalog.INFO, InfoRequest(), world=self._world, timeout_s=CALL_TIMEOUT_S
        )


def _read_factor(parameter: WorldParameter) -> float:
    value = parameter.value
    if parameter.name != SPEED_PARAMETER:
        raise ValueError(
            f"parameter {parameter.name[:80]!r} is unknown; the parameter is {SPEED_PARAMETER}"
        )
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number:
        raise ValueError(f"{SPEED_PARAMETER} {value!r:.80} is not a number; use one of 0 or more")
    return float(cast("float", value))


def _describe_form(kind: type[msgspec.Struct]) -> MessageForm:
    name = str(vars(find_ros_class(kind))["ros_type"])
    return MessageForm("cdr", name, ROS_SCHEMA, write_definition(kind))
