"""ROS 2 services: names, types, keys; adapters for simulation_interfaces 1.x and gazebo_msgs."""

from functools import cached_property
from typing import Final

import msgspec

from zensim.proto import service_catalog
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    encode,
    make_encoding,
    supports_format,
)
from zensim.proto.ros2.earlier_service_types import (
    RESPONSE_ADAPTERS,
    GazeboDeleteEntityRequest,
    GazeboDeleteEntityResponse,
    GazeboSpawnEntityRequest,
    GazeboSpawnEntityResponse,
    GetSpawnablesResponseV1,
    LoadWorldRequestV1,
    SetEntityStateRequestV1,
    SpawnEntityRequestV1,
    adapt_request,
    adapt_response,
)
from zensim.proto.ros2.rmw_keys import ANY_HASH, NO_HASH, make_data_key
from zensim.proto.ros2.type_hash import find_service_type, hash_service

GAZEBO_PREFIX: Final = "gazebo_"
"""Prefix of zensim services whose name simulation_interfaces uses, too."""
OWN_TYPE_PREFIX: Final = "zensim/"
"""Types that are not in any ROS distribution."""
SIMULATOR_PACKAGES: Final = ("gazebo_msgs", "simulation_interfaces")
"""Packages whose services only simulators offer at the root."""
CDR_ENCODING_NAME: Final = str(Format.CDR.value)


class RosService(msgspec.Struct, frozen=True, dict=True):
    """A service with the types of one interface version."""

    service: str
    """Name in the service catalog."""
    request: type[msgspec.Struct]
    response: type[msgspec.Struct]
    is_humble_form: bool = False
    """Whether humble has this version, in which keys have no hash."""

    @property
    def name(self) -> str:
        """ROS name, with the leading slash."""
        return f"/{self.service.removeprefix(GAZEBO_PREFIX)}"

    @cached_property
    def ros_type(self) -> str:
        """`pkg/srv/Name`."""
        return find_service_type(self.request)

    @cached_property
    def type_hash(self) -> str:
        """Type hash of all distributions but humble."""
        return hash_service(self.request, self.response)

    @property
    def bridge_key(self) -> str:
        """Key on which zenoh-bridge-ros2dds calls."""
        is_gazebo = self.ros_type.startswith("gazebo_msgs/") or self.service.startswith(
            GAZEBO_PREFIX
        )
        folder = "gazebo" if is_gazebo else ""
        return f"{folder}{self.name}".lstrip("/")

    def list_keys(self, domain: int) -> tuple[str, ...]:
        """List the keys on which rmw_zenoh calls, of all distributions with this version."""
        hashes = (self.type_hash, NO_HASH) if self.is_humble_form else (self.type_hash,)
        return tuple(make_data_key(domain, self.name, self.ros_type, one) for one in hashes)

    def decode_request(self, payload: bytes) -> msgspec.Struct:
        """Decode a request and convert it to that of the catalog.

        Raises:
            MalformedPayload: The bytes are not CDR of this request.
        """
        return adapt_request(decode(self.request, payload, CDR_ENCODING_NAME))

    def encode_response(self, payload: bytes, encoding: str) -> bytes:
        """Convert an encoded response of the catalog to CDR of this version."""
        ours = service_catalog.SERVICES[self.service].response
        if encoding == make_encoding(ours, Format.CDR) and self.response not in RESPONSE_ADAPTERS:
            return payload
        try:
            response = decode(ours, payload, encoding)
        except MalformedPayload:
            response = ours()  # a refusal, and the response type has no result
        return encode(adapt_response(response, self.response), Format.CDR)


V1_SERVICES: Final = (
    RosService(
        "spawn_entity",
        SpawnEntityRequestV1,
        service_catalog.SPAWN_ENTITY.response,
        is_humble_form=True,
    ),
    RosService(
        "load_world", LoadWorldRequestV1, service_catalog.LOAD_WORLD.response, is_humble_form=True
    ),
    RosService(
        "set_entity_state",
        SetEntityStateRequestV1,
        service_catalog.SET_ENTITY_STATE.response,
        is_humble_form=True,
    ),
    RosService(
        "get_spawnables",
        service_catalog.GET_SPAWNABLES.request,
        GetSpawnablesResponseV1,
        is_humble_form=True,
    ),
)
CHANGED_SINCE_V1: Final = frozenset(one.service for one in V1_SERVICES)
"""Services that differ between humble and simulation_interfaces 2.1."""
GAZEBO_SPAWN_SERVICES: Final = (
    RosService(
        "spawn_entity", GazeboSpawnEntityRequest, GazeboSpawnEntityResponse, is_humble_form=True
    ),
    RosService(
        "delete_entity", GazeboDeleteEntityRequest, GazeboDeleteEntityResponse, is_humble_form=True
    ),
)


def _list_ros_services() -> tuple[RosService, ...]:
    current = [
        RosService(
            one.name, one.request, one.response, is_humble_form=one.name not in CHANGED_SINCE_V1
        )
        for one in service_catalog.SERVICES.values()
        if supports_format(one.request, Format.CDR)
        and supports_format(one.response, Format.CDR)
        and not find_service_type(one.request).startswith(OWN_TYPE_PREFIX)
    ]
    return (*current, *V1_SERVICES, *GAZEBO_SPAWN_SERVICES)


ROS_SERVICES: Final = _list_ros_services()
"""Every version of every service, the newest first."""


def index_by_key(domain: int) -> dict[str, tuple[RosService, ...]]:
    """Map the keys of rmw_zenoh to versions of services, the newest first.

    A key with a hash has one version. One of humble, which has none, has all whose requests differ,
    because simulation_interfaces 2 can be built there, too; that of humble is the last.
    """
    return {
        key: (*_list_other_versions(one), one) if key.endswith(NO_HASH) else (one,)
        for one in ROS_SERVICES
        for key in one.list_keys(domain)
    }


def _list_other_versions(humble: RosService) -> list[RosService]:
    return [
        one
        for one in ROS_SERVICES
        if (one.name, one.ros_type) == (humble.name, humble.ros_type)
        and one.request is not humble.request
    ]


def index_by_bridge_key() -> dict[str, tuple[RosService, ...]]:
    """Map the keys of a bridge to versions of services, the newest first."""
    keys = dict.fromkeys(one.bridge_key for one in ROS_SERVICES)
    return {key: tuple(one for one in ROS_SERVICES if one.bridge_key == key) for key in keys}


def find_served_keys(domain: int) -> tuple[str, ...]:
    """Find few key expressions that match all keys of a domain, and no other services."""
    simulator_keys = {f"{domain}/*/{package}::srv::dds_::$*/*" for package in SIMULATOR_PACKAGES}
    other_keys = {
        make_data_key(domain, one.name, one.ros_type, ANY_HASH)
        for one in ROS_SERVICES
        if one.ros_type.partition("/")[0] not in SIMULATOR_PACKAGES
    }
    return (*sorted(simulator_keys), *sorted(other_keys))
