"""Services and topics of Gazebo Classic, with the fields of gazebo_msgs and std_srvs."""

from enum import IntEnum
from typing import ClassVar

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt8
from zensim.proto.messages.standard_messages import (
    Duration,
    Header,
    Point,
    Pose,
    Time,
    Twist,
    Vector3,
    Wrench,
)


class EmptyRequest(msgspec.Struct, frozen=True):
    """Request without fields. Source: std_srvs/srv/Empty."""

    ros_type: ClassVar[str] = "std_srvs/srv/Empty_Request"


class PausePhysicsRequest(EmptyRequest, frozen=True):
    """Pause the simulation."""


class UnpausePhysicsRequest(EmptyRequest, frozen=True):
    """Resume the simulation."""


class ResetWorldRequest(EmptyRequest, frozen=True):
    """Reset every entity to its spawn pose, without resetting time."""


class GazeboResetSimulationRequest(EmptyRequest, frozen=True):
    """Reset time, and every entity to its spawn pose."""


class EmptyResponse(msgspec.Struct, frozen=True):
    """Response without fields. Source: std_srvs/srv/Empty."""

    ros_type: ClassVar[str] = "std_srvs/srv/Empty_Response"


class EmptyReport(EmptyResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class GazeboEntityState(msgspec.Struct, frozen=True):
    """State of a model or a link, in a frame. Source: gazebo_msgs/msg/EntityState."""

    ros_type: ClassVar[str] = "gazebo_msgs/msg/EntityState"

    name: str = ""
    """`entity` or `entity::link`."""
    pose: Pose = Pose()
    twist: Twist = Twist()
    reference_frame: str = ""
    """`entity`, `entity::link`, or empty for the world frame."""


class GazeboGetEntityStateRequest(msgspec.Struct, frozen=True):
    """Get the state of a model or a link. Source: gazebo_msgs/srv/GetEntityState."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetEntityState_Request"

    name: str = ""
    reference_frame: str = ""


class GazeboGetEntityStateResponse(msgspec.Struct, frozen=True):
    """State of the model or link. Source: gazebo_msgs/srv/GetEntityState."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetEntityState_Response"

    header: Header = Header()
    state: GazeboEntityState = GazeboEntityState()
    success: bool = False


class GazeboGetEntityStateReport(GazeboGetEntityStateResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class GetModelListRequest(msgspec.Struct, frozen=True):
    """List the entities. Source: gazebo_msgs/srv/GetModelList."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetModelList_Request"


class GetModelListResponse(msgspec.Struct, frozen=True):
    """Names of all entities, and simulation time. Source: gazebo_msgs/srv/GetModelList."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetModelList_Response"

    header: Header = Header()
    model_names: tuple[str, ...] = ()
    success: bool = False


class GetModelListReport(GetModelListResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class GazeboSetEntityStateRequest(msgspec.Struct, frozen=True):
    """Set the state of an entity. Source: gazebo_msgs/srv/SetEntityState."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetEntityState_Request"

    state: GazeboEntityState = GazeboEntityState()


class GazeboSetEntityStateResponse(msgspec.Struct, frozen=True):
    """Whether the state is set. Source: gazebo_msgs/srv/SetEntityState."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetEntityState_Response"

    success: bool = False


class GazeboSetEntityStateReport(GazeboSetEntityStateResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class ModelStates(msgspec.Struct, frozen=True):
    """States of all entities in the world frame. Source: gazebo_msgs/msg/ModelStates."""

    ros_type: ClassVar[str] = "gazebo_msgs/msg/ModelStates"

    name: tuple[str, ...] = ()
    pose: tuple[Pose, ...] = ()
    twist: tuple[Twist, ...] = ()


class LinkStates(msgspec.Struct, frozen=True):
    """States of all links (`entity::link`) in the world. Source: gazebo_msgs/msg/LinkStates."""

    ros_type: ClassVar[str] = "gazebo_msgs/msg/LinkStates"

    name: tuple[str, ...] = ()
    pose: tuple[Pose, ...] = ()
    twist: tuple[Twist, ...] = ()


class ContactState(msgspec.Struct, frozen=True):
    """Contacts of two collisions; vectors are in the world. Source: gazebo_msgs/msg/ContactState.

    Sequences have an item per contact point.
    """

    ros_type: ClassVar[str] = "gazebo_msgs/msg/ContactState"

    info: str = ""
    collision1_name: str = ""
    """Collision of the sensor: `entity::link::collision`."""
    collision2_name: str = ""
    wrenches: tuple[Wrench, ...] = ()
    """Wrenches on the first body."""
    total_wrench: Wrench = Wrench()
    contact_positions: tuple[Vector3, ...] = ()
    """[m]."""
    contact_normals: tuple[Vector3, ...] = ()
    """Towards the first body."""
    depths: tuple[float, ...] = ()
    """[m], positive when overlapping."""


class ContactsState(msgspec.Struct, frozen=True):
    """Contacts of the collisions of a sensor. Source: gazebo_msgs/msg/ContactsState."""

    ros_type: ClassVar[str] = "gazebo_msgs/msg/ContactsState"

    header: Header = Header()
    states: tuple[ContactState, ...] = ()
    """One per pair of collisions; empty while nothing touches."""


class ApplyLinkWrenchRequest(msgspec.Struct, frozen=True):
    """Apply a wrench to a link for a duration. Source: gazebo_msgs/srv/ApplyLinkWrench."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/ApplyLinkWrench_Request"

    link_name: str = ""
    """`entity::link`."""
    reference_frame: str = ""
    """Frame of the wrench; empty = the world frame."""
    reference_point: Point = Point()
    """Point in the reference frame; from the centre of mass of the link if that is empty."""
    wrench: Wrench = Wrench()
    start_time: Time = Time()
    """Simulation time; a time in the past means now."""
    duration: Duration = Duration()
    """Simulation time; negative = unlimited, 0 = never, else at least one step."""


class ApplyLinkWrenchResponse(msgspec.Struct, frozen=True):
    """Whether the wrench is accepted. Source: gazebo_msgs/srv/ApplyLinkWrench."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/ApplyLinkWrench_Response"

    success: bool = False
    status_message: str = ""


class ApplyLinkWrenchReport(ApplyLinkWrenchResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class ClearLinkWrenchesRequest(msgspec.Struct, frozen=True):
    """Remove the wrenches of a link. Source: gazebo_msgs/srv/LinkRequest."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/LinkRequest_Request"

    link_name: str = ""


class ClearLinkWrenchesResponse(msgspec.Struct, frozen=True):
    """Response without fields. Source: gazebo_msgs/srv/LinkRequest."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/LinkRequest_Response"


class ClearLinkWrenchesReport(ClearLinkWrenchesResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class ApplyJointEffortRequest(msgspec.Struct, frozen=True):
    """Apply an effort to a joint for a duration. Source: gazebo_msgs/srv/ApplyJointEffort."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/ApplyJointEffort_Request"

    joint_name: str = ""
    """`entity::joint`, or `joint` if only one entity has it."""
    effort: float = 0.0
    """[N m] or [N]."""
    start_time: Time = Time()
    duration: Duration = Duration()


class ApplyJointEffortResponse(msgspec.Struct, frozen=True):
    """Whether the effort is accepted. Source: gazebo_msgs/srv/ApplyJointEffort."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/ApplyJointEffort_Response"

    success: bool = False
    status_message: str = ""


class ApplyJointEffortReport(ApplyJointEffortResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class ClearJointEffortsRequest(msgspec.Struct, frozen=True):
    """Remove the efforts of a joint. Source: gazebo_msgs/srv/JointRequest."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/JointRequest_Request"

    joint_name: str = ""


class ClearJointEffortsResponse(msgspec.Struct, frozen=True):
    """Response without fields. Source: gazebo_msgs/srv/JointRequest."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/JointRequest_Response"


class ClearJointEffortsReport(ClearJointEffortsResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class JointType(IntEnum):
    """Kinds of joints. Source: gazebo_msgs/srv/GetJointProperties."""

    REVOLUTE = 0
    CONTINUOUS = 1
    PRISMATIC = 2
    FIXED = 3
    BALL = 4
    UNIVERSAL = 5


class GetJointPropertiesRequest(msgspec.Struct, frozen=True):
    """Get the properties of a joint. Source: gazebo_msgs/srv/GetJointProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetJointProperties_Request"

    joint_name: str = ""


class GetJointPropertiesResponse(msgspec.Struct, frozen=True):
    """Properties with one number per axis. Source: gazebo_msgs/srv/GetJointProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetJointProperties_Response"

    type: UInt8 = JointType.REVOLUTE
    damping: tuple[float, ...] = ()
    position: tuple[float, ...] = ()
    rate: tuple[float, ...] = ()
    success: bool = False
    status_message: str = ""


class GetJointPropertiesReport(GetJointPropertiesResponse, frozen=True):
    """Adds the result, and properties that gazebo_msgs does not have."""

    result: Result = Result()
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    friction: tuple[float, ...] = ()


class ODEJointProperties(msgspec.Struct, frozen=True):
    """Settings of a joint, one number for its axis; empty = unchanged.

    Source: gazebo_msgs/msg/ODEJointProperties.
    """

    ros_type: ClassVar[str] = "gazebo_msgs/msg/ODEJointProperties"

    damping: tuple[float, ...] = ()
    hi_stop: tuple[float, ...] = ()
    lo_stop: tuple[float, ...] = ()
    erp: tuple[float, ...] = ()
    cfm: tuple[float, ...] = ()
    stop_erp: tuple[float, ...] = ()
    stop_cfm: tuple[float, ...] = ()
    fudge_factor: tuple[float, ...] = ()
    fmax: tuple[float, ...] = ()
    """Friction: maximum effort against motion."""
    vel: tuple[float, ...] = ()


class SetJointPropertiesRequest(msgspec.Struct, frozen=True):
    """Set the properties of a joint. Source: gazebo_msgs/srv/SetJointProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetJointProperties_Request"

    joint_name: str = ""
    ode_joint_config: ODEJointProperties = ODEJointProperties()


class SetJointPropertiesResponse(msgspec.Struct, frozen=True):
    """Whether the properties are set. Source: gazebo_msgs/srv/SetJointProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetJointProperties_Response"

    success: bool = False
    status_message: str = ""


class SetJointPropertiesReport(SetJointPropertiesResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class GetLinkPropertiesRequest(msgspec.Struct, frozen=True):
    """Get the mass properties of a link. Source: gazebo_msgs/srv/GetLinkProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetLinkProperties_Request"

    link_name: str = ""


class GetLinkPropertiesResponse(msgspec.Struct, frozen=True):
    """Mass properties of the link. Source: gazebo_msgs/srv/GetLinkProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/GetLinkProperties_Response"

    com: Pose = Pose()
    """Pose of the centre of mass and of the axes of the moments, in the link."""
    gravity_mode: bool = True
    mass: float = 0.0
    ixx: float = 0.0
    ixy: float = 0.0
    ixz: float = 0.0
    iyy: float = 0.0
    iyz: float = 0.0
    izz: float = 0.0
    success: bool = False
    status_message: str = ""


class GetLinkPropertiesReport(GetLinkPropertiesResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()


class SetLinkPropertiesRequest(msgspec.Struct, frozen=True):
    """Set all mass properties of a link. Source: gazebo_msgs/srv/SetLinkProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetLinkProperties_Request"

    link_name: str = ""
    com: Pose = Pose()
    gravity_mode: bool = True
    mass: float = 0.0
    ixx: float = 0.0
    ixy: float = 0.0
    ixz: float = 0.0
    iyy: float = 0.0
    iyz: float = 0.0
    izz: float = 0.0


class SetLinkPropertiesResponse(msgspec.Struct, frozen=True):
    """Whether the properties are set. Source: gazebo_msgs/srv/SetLinkProperties."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SetLinkProperties_Response"

    success: bool = False
    status_message: str = ""


class SetLinkPropertiesReport(SetLinkPropertiesResponse, frozen=True):
    """Adds the result."""

    result: Result = Result()
