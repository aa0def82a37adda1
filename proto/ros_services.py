"""Which of our services ROS 2 can ask for, under which names and types. Pure.

`/spawn_entity` has several types at once: the type is part of rmw_zenoh's key. A bridge's keys have
none, so that gazebo_msgs stands under `gazebo/` there.
"""

from functools import cached_property
from typing import Final

import msgspec

from zensim.proto import catalog, ros_forms
from zensim.proto.codec import Format, MalformedPayload, decode, encode, encoding_of, offers
from zensim.proto.ros2.keys import ANY_HASH, NO_HASH, data_key
from zensim.proto.ros2.type_hash import service_hash, service_type

GAZEBO: Final = "gazebo_"
"""Begins names of ours whose own the standard has taken."""
OWN: Final = "zensim/"
"""Types that no ROS distribution has."""
PACKAGES: Final = ("gazebo_msgs", "simulation_interfaces")
"""Whose services nobody but a simulator offers at the root."""
CDR: Final = str(Format.CDR.value)


class RosService(msgspec.Struct, frozen=True, dict=True):
    """One service in one form."""

    service: str
    """Its name among ours."""
    request: type[msgspec.Struct]
    response: type[msgspec.Struct]
    is_of_humble: bool = False
    """Whether this is the form that humble has, whose keys carry no hash."""

    @property
    def name(self) -> str:
        """Its name in ROS, with the slash."""
        return f"/{self.service.removeprefix(GAZEBO)}"

    @cached_property
    def ros_type(self) -> str:
        """`pkg/srv/Name`."""
        return service_type(self.request)

    @cached_property
    def type_hash(self) -> str:
        """As all distributions but humble have it."""
        return service_hash(self.request, self.response)

    @property
    def bridge_key(self) -> str:
        """Where zenoh-bridge-ros2dds asks."""
        folder = "gazebo" if self.ros_type.startswith("gazebo_msgs/") else ""
        return f"{folder}{self.name}".lstrip("/")

    def keys(self, domain: int) -> tuple[str, ...]:
        """Where rmw_zenoh asks, on all distributions that have this form."""
        hashes = (self.type_hash, NO_HASH) if self.is_of_humble else (self.type_hash,)
        return tuple(data_key(domain, self.name, self.ros_type, one) for one in hashes)

    def read(self, payload: bytes) -> msgspec.Struct:
        """Read a request, and say it in our own words.

        Raises:
            MalformedPayload: The bytes are not CDR of this request.
        """
        return ros_forms.our_request(decode(self.request, payload, CDR))

    def answer(self, payload: bytes, encoding: str) -> bytes:
        """Write our own response, however it is encoded, as CDR of this form."""
        ours = catalog.SERVICES[self.service].response
        if encoding == encoding_of(ours, Format.CDR) and self.response not in ros_forms.RESPONSES:
            return payload
        try:
            response = decode(ours, payload, encoding)
        except MalformedPayload:
            response = ours()  # a refusal of a service whose response has no place for a result
        return encode(ros_forms.their_response(response, self.response), Format.CDR)


VERSION_1: Final = (
    RosService(
        "spawn_entity",
        ros_forms.SpawnEntityRequestV1,
        catalog.SPAWN_ENTITY.response,
        is_of_humble=True,
    ),
    RosService(
        "load_world",
        ros_forms.LoadWorldRequestV1,
        catalog.LOAD_WORLD.response,
        is_of_humble=True,
    ),
    RosService(
        "set_entity_state",
        ros_forms.SetEntityStateRequestV1,
        catalog.SET_ENTITY_STATE.response,
        is_of_humble=True,
    ),
    RosService(
        "get_spawnables",
        catalog.GET_SPAWNABLES.request,
        ros_forms.GetSpawnablesResponseV1,
        is_of_humble=True,
    ),
)
OTHERWISE: Final = frozenset(one.service for one in VERSION_1)
"""Services that humble has in another form than simulation_interfaces 2.1."""
GAZEBO_SPAWNING: Final = (
    RosService(
        "spawn_entity",
        ros_forms.GazeboSpawnEntityRequest,
        ros_forms.GazeboSpawnEntityResponse,
        is_of_humble=True,
    ),
    RosService(
        "delete_entity",
        ros_forms.GazeboDeleteEntityRequest,
        ros_forms.GazeboDeleteEntityResponse,
        is_of_humble=True,
    ),
)


def _services() -> tuple[RosService, ...]:
    ours = [
        RosService(one.name, one.request, one.response, is_of_humble=one.name not in OTHERWISE)
        for one in catalog.SERVICES.values()
        if offers(one.request, Format.CDR)
        and offers(one.response, Format.CDR)
        and not service_type(one.request).startswith(OWN)
    ]
    return (*ours, *VERSION_1, *GAZEBO_SPAWNING)


ROS_SERVICES: Final = _services()
"""Every form of every service, the newest first."""


def by_key(domain: int) -> dict[str, tuple[RosService, ...]]:
    """Find the services by the keys at which rmw_zenoh asks."""
    return {key: (one,) for one in ROS_SERVICES for key in one.keys(domain)}


def by_bridge_key() -> dict[str, tuple[RosService, ...]]:
    """Find the forms of services by the keys at which a bridge asks, the newest first."""
    keys = dict.fromkeys(one.bridge_key for one in ROS_SERVICES)
    return {key: tuple(one for one in ROS_SERVICES if one.bridge_key == key) for key in keys}


def served_keys(domain: int) -> tuple[str, ...]:
    """Find as few key expressions as cover all keys of a domain, and nobody else's service."""
    ours = {f"{domain}/*/{package}::srv::dds_::$*/*" for package in PACKAGES}
    shared = {
        data_key(domain, one.name, one.ros_type, ANY_HASH)
        for one in ROS_SERVICES
        if one.ros_type.partition("/")[0] not in PACKAGES
    }
    return (*sorted(ours), *sorted(shared))
