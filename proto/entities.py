"""Services about one entity or many: info, bounds, states in any frame. simulation_interfaces 2.1.

What an Order adds to its Request travels in MessagePack and JSON only.
"""

from typing import ClassVar, Final

import msgspec

from zensim.proto.info import EntityInfo
from zensim.proto.model import TierName
from zensim.proto.result import Result
from zensim.proto.services import Bounds, EntityFilters, EntityState, GetEntityStateRequest
from zensim.proto.widths import UInt8

ANY_BOUNDS: Final = 255
"""As the type of bounds that are asked for: the server chooses."""


class GetEntitiesStatesRequest(msgspec.Struct, frozen=True):
    """Ask where entities are. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesStatesOrder(GetEntitiesStatesRequest, frozen=True):
    """The same in a frame of choice."""

    reference_frame: str = ""
    """Empty = the world's."""


class GetEntitiesStatesResponse(msgspec.Struct, frozen=True):
    """Names and states of one step. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()
    states: tuple[EntityState, ...] = ()


class GetEntityStateOrder(GetEntityStateRequest, frozen=True):
    """Ask where an entity is, in a frame of choice."""

    reference_frame: str = ""
    """Empty = the world's."""


class GetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Ask what an entity is. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Request"

    entity: str = ""


class GetEntityInfoResponse(msgspec.Struct, frozen=True):
    """What it is. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Response"

    result: Result = Result()
    info: EntityInfo = EntityInfo()


class GetEntityInfoReport(GetEntityInfoResponse, frozen=True):
    """The same, and how it moves now."""

    dynamics: TierName = "full"
    """full: by forces and contacts; kinematic: as its drive says."""


class SetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Say what an entity is, all of it anew. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Request"

    entity: str = ""
    info: EntityInfo = EntityInfo()


class SetEntityInfoResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Response"

    result: Result = Result()


class GetEntityBoundsRequest(msgspec.Struct, frozen=True):
    """Ask how much room an entity takes. Source: simulation_interfaces/srv/GetEntityBounds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Request"

    entity: str = ""


class GetEntityBoundsOrder(GetEntityBoundsRequest, frozen=True):
    """The same in a shape of choice."""

    type: UInt8 = ANY_BOUNDS
    """One of `BoundsType`; 255 = a box."""


class GetEntityBoundsResponse(msgspec.Struct, frozen=True):
    """Of its collisions as the joints stand, in the frame of its base link.

    Empty when it collides with nothing. Source: simulation_interfaces/srv/GetEntityBounds.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Response"

    result: Result = Result()
    bounds: Bounds = Bounds()
