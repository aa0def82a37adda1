"""Services of simulation_interfaces 2.1 on entities: list, filter, info, bounds, state."""

from enum import IntEnum
from typing import ClassVar, Final

import msgspec

from zensim.proto.messages.model_messages import TierName
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt8
from zensim.proto.messages.standard_messages import Accel, Header, Point, Pose, Twist, Vector3

MAX_TAGS = 64
MAX_TAG_LENGTH = 128
"""Characters of one tag."""
MAX_DESCRIPTION_LENGTH = 4096


class Category(IntEnum):
    """Kinds of entities. Source: simulation_interfaces/msg/EntityCategory."""

    OBJECT = 0
    ROBOT = 1
    HUMAN = 2
    DYNAMIC_OBJECT = 4
    STATIC_OBJECT = 5


class EntityCategory(msgspec.Struct, frozen=True, gc=False):
    """Category of an entity. Source: simulation_interfaces/msg/EntityCategory."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityCategory"

    category: UInt8 = Category.OBJECT


class EntityInfo(msgspec.Struct, frozen=True, gc=False):
    """Category, description, and tags for filters. Source: simulation_interfaces/msg/EntityInfo.

    Limits: `MAX_TAGS` tags of `MAX_TAG_LENGTH` characters, `MAX_DESCRIPTION_LENGTH`.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityInfo"

    category: EntityCategory = EntityCategory()
    description: str = ""
    tags: tuple[str, ...] = ()


class FilterMode(IntEnum):
    """Number of tags that must match. Source: simulation_interfaces/msg/TagsFilter."""

    ANY = 0
    ALL = 1


class TagsFilter(msgspec.Struct, frozen=True):
    """Filter by tags. Source: simulation_interfaces/msg/TagsFilter."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/TagsFilter"

    tags: tuple[str, ...] = ()
    filter_mode: UInt8 = FilterMode.ANY


class BoundsType(IntEnum):
    """Shapes of a region. Source: simulation_interfaces/msg/Bounds."""

    EMPTY = 0
    BOX = 1
    CONVEX_HULL = 2
    SPHERE = 3


class Bounds(msgspec.Struct, frozen=True):
    """A region, in a frame that its owner defines. Source: simulation_interfaces/msg/Bounds.

    Points by type: empty (unbounded), none; axis-aligned box, upper and lower corner; convex hull,
    at least 3 that are not collinear; sphere, the centre, and a second point with the radius as x.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Bounds"

    type: UInt8 = BoundsType.EMPTY
    points: tuple[Vector3, ...] = ()


class EntityFilters(msgspec.Struct, frozen=True):
    """Selects the entities that match all filters; an empty filter matches all.

    `filter` is a POSIX extended regular expression for any part of the name; the entity overlaps
    `bounds`, in the world frame. Source: simulation_interfaces/msg/EntityFilters.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityFilters"

    filter: str = ""
    categories: tuple[EntityCategory, ...] = ()
    tags: TagsFilter = TagsFilter()
    bounds: Bounds = Bounds()


class GetEntitiesRequest(msgspec.Struct, frozen=True):
    """List entities. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesResponse(msgspec.Struct, frozen=True):
    """Names, in spawn order. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()


class EntityState(msgspec.Struct, frozen=True):
    """Pose and twist of an entity's base. Source: simulation_interfaces/msg/EntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityState"

    header: Header = Header()
    pose: Pose = Pose()
    twist: Twist = Twist()
    acceleration: Accel = Accel()


class GetEntityStateRequest(msgspec.Struct, frozen=True):
    """Get the state of an entity. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Request"

    entity: str = ""


class GetEntityStateResponse(msgspec.Struct, frozen=True):
    """State in the world frame. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Response"

    result: Result = Result()
    state: EntityState = EntityState()


class SetEntityStateRequest(msgspec.Struct, frozen=True):
    """Set the state of an entity. Source: simulation_interfaces/srv/SetEntityState, 2.1."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Request"

    entity: str = ""
    state: EntityState = EntityState()
    set_pose: bool = False
    set_twist: bool = False
    set_acceleration: bool = False


class SetEntityStateResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/SetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Response"

    result: Result = Result()


ANY_BOUNDS: Final = 255
"""Requested type of bounds: the server chooses."""


class GetEntitiesStatesRequest(msgspec.Struct, frozen=True):
    """Get the states of entities. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesStatesOrder(GetEntitiesStatesRequest, frozen=True):
    """Adds the reference frame."""

    reference_frame: str = ""
    """Empty = the world frame."""


class GetEntitiesStatesResponse(msgspec.Struct, frozen=True):
    """Names and states at one step. Source: simulation_interfaces/srv/GetEntitiesStates."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntitiesStates_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()
    states: tuple[EntityState, ...] = ()


class GetEntityStateOrder(GetEntityStateRequest, frozen=True):
    """Adds the reference frame."""

    reference_frame: str = ""
    """Empty = the world frame."""


class GetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Get the info of an entity. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Request"

    entity: str = ""


class GetEntityInfoResponse(msgspec.Struct, frozen=True):
    """Info of the entity. Source: simulation_interfaces/srv/GetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityInfo_Response"

    result: Result = Result()
    info: EntityInfo = EntityInfo()


class GetEntityInfoReport(GetEntityInfoResponse, frozen=True):
    """Adds the current dynamics."""

    dynamics: TierName = "full"
    """full: forces and contacts; kinematic: motion computed by the drive."""


class SetEntityInfoRequest(msgspec.Struct, frozen=True):
    """Replace the info of an entity. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Request"

    entity: str = ""
    info: EntityInfo = EntityInfo()


class SetEntityInfoResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/SetEntityInfo."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityInfo_Response"

    result: Result = Result()


NOTHING_HIT_M = -1.0
"""Range of a ray that hits nothing; JSON has no infinity."""


class CastRaysRequest(msgspec.Struct, frozen=True):
    """Find what rays hit first: the collisions of entities, and the ground."""

    ros_type: ClassVar[str] = "zensim/srv/CastRays_Request"

    origins: tuple[Point, ...] = ()
    """Starts of rays in the world frame; at most 10 000."""
    directions: tuple[Vector3, ...] = ()
    """Directions in the world frame, of any length but 0; as many as origins."""
    range_max_m: float = 100.0
    """Hits beyond it do not count; > 0."""
    ignored_entity: str = ""
    """Entity that the rays pass through; empty = none."""


class CastRaysResponse(msgspec.Struct, frozen=True):
    """The first hit of each ray."""

    ros_type: ClassVar[str] = "zensim/srv/CastRays_Response"

    result: Result = Result()
    ranges: tuple[float, ...] = ()
    """[m]; -1 where nothing is hit."""
    entities: tuple[str, ...] = ()
    """Names; empty where nothing or the ground is hit."""


class GetEntityBoundsRequest(msgspec.Struct, frozen=True):
    """Get the bounds of an entity. Source: simulation_interfaces/srv/GetEntityBounds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Request"

    entity: str = ""


class GetEntityBoundsOrder(GetEntityBoundsRequest, frozen=True):
    """Adds the type of the bounds."""

    type: UInt8 = ANY_BOUNDS
    """One of `BoundsType`; 255 = a box."""


class GetEntityBoundsResponse(msgspec.Struct, frozen=True):
    """Bounds of its collisions at the current joint positions, in the frame of its base link.

    Empty if it has no collisions. Source: simulation_interfaces/srv/GetEntityBounds.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityBounds_Response"

    result: Result = Result()
    bounds: Bounds = Bounds()
