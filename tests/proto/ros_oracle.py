"""An independent CDR implementation with all ROS types of proto and some of zensim."""

from typing import Any

import msgspec
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
EMPTY = "uint8 structure_needs_at_least_one_member"
SIMULATION_INTERFACES = {
    "Result": "uint8 result; string error_message",
    "Resource": "string uri; string resource_string",
    "EntityCategory": "uint8 category",
    "TagsFilter": "string[] tags; uint8 filter_mode",
    "Bounds": "uint8 type; geometry_msgs/Vector3[] points",
    "EntityFilters": "string filter; EntityCategory[] categories; TagsFilter tags; Bounds bounds",
    "EntityState": "std_msgs/Header header; geometry_msgs/Pose pose; geometry_msgs/Twist twist;"
    " geometry_msgs/Accel acceleration",
    "EntityInfo": "EntityCategory category; string description; string[] tags",
    "NamedPose": "string name; string description; string[] tags; geometry_msgs/Pose pose",
    "Spawnable": "Resource entity_resource; string description; Bounds spawn_bounds",
    "SpawnEntity": "string name; bool allow_renaming; Resource entity_resource;"
    " string entity_namespace; geometry_msgs/PoseStamped initial_pose",
    "SpawnResult": "Result result; string entity_name",
    "SpawnEntities_Request": "SpawnEntity[] spawn_requests",
    "SpawnEntities_Response": "Result result; SpawnResult[] results",
    "GetEntitiesStates_Request": "EntityFilters filters",
    "GetEntitiesStates_Response": "Result result; string[] entities; EntityState[] states",
    "GetEntityInfo_Request": "string entity",
    "GetEntityInfo_Response": "Result result; EntityInfo info",
    "SetEntityInfo_Request": "string entity; EntityInfo info",
    "SetEntityInfo_Response": "Result result",
    "GetEntityBounds_Request": "string entity",
    "GetEntityBounds_Response": "Result result; Bounds bounds",
    "GetSpawnables_Request": "string[] sources",
    "GetSpawnables_Response": "Result result; Spawnable[] spawnables",
    "GetNamedPoses_Request": "TagsFilter tags",
    "GetNamedPoses_Response": "Result result; NamedPose[] poses",
    "GetNamedPoseBounds_Request": "string name",
    "GetNamedPoseBounds_Response": "Result result; Bounds bounds",
    "SimulationState": "uint8 state",
    "SimulatorFeatures": "uint16[] features; string[] spawn_formats; string custom_info",
    "SpawnEntity_Request": "string name; bool allow_renaming; Resource entity_resource;"
    " string entity_namespace; geometry_msgs/PoseStamped initial_pose",
    "SpawnEntity_Response": "Result result; string entity_name",
    "DeleteEntity_Request": "string entity",
    "DeleteEntity_Response": "Result result",
    "GetEntities_Request": "EntityFilters filters",
    "GetEntities_Response": "Result result; string[] entities",
    "GetEntityState_Request": "string entity",
    "GetEntityState_Response": "Result result; EntityState state",
    "SetEntityState_Request": "string entity; EntityState state; bool set_pose; bool set_twist;"
    " bool set_acceleration",
    "SetEntityState_Response": "Result result",
    "GetSimulationState_Request": EMPTY,
    "GetSimulationState_Response": "SimulationState state; Result result",
    "SetSimulationState_Request": "SimulationState state",
    "SetSimulationState_Response": "Result result",
    "StepSimulation_Request": "uint64 steps",
    "StepSimulation_Response": "Result result",
    "ResetSimulation_Request": "uint8 scope",
    "ResetSimulation_Response": "Result result",
    "WorldResource": "string name; Resource world_resource; string description; string[] tags",
    "LoadWorld_Request": "Resource world_resource; bool fail_on_unsupported_element;"
    " bool ignore_missing_or_unsupported_assets",
    "LoadWorld_Response": "Result result; WorldResource world",
    "UnloadWorld_Request": EMPTY,
    "UnloadWorld_Response": "Result result",
    "GetCurrentWorld_Request": EMPTY,
    "GetCurrentWorld_Response": "Result result; WorldResource world",
    "GetAvailableWorlds_Request": "string[] additional_sources; TagsFilter filter;"
    " bool offline_only; bool continue_on_error",
    "GetAvailableWorlds_Response": "Result result; WorldResource[] worlds",
    "GetSimulatorFeatures_Request": EMPTY,
    "GetSimulatorFeatures_Response": "SimulatorFeatures features",
}
_MASSES = (
    "geometry_msgs/Pose com; bool gravity_mode; float64 mass; float64 ixx; float64 ixy;"
    " float64 ixz; float64 iyy; float64 iyz; float64 izz"
)
_DONE = "bool success; string status_message"
GAZEBO = {
    "EntityState": "string name; geometry_msgs/Pose pose; geometry_msgs/Twist twist;"
    " string reference_frame",
    "GetEntityState_Request": "string name; string reference_frame",
    "GetEntityState_Response": "std_msgs/Header header; gazebo_msgs/EntityState state;"
    " bool success",
    "GetModelList_Request": EMPTY,
    "GetModelList_Response": "std_msgs/Header header; string[] model_names; bool success",
    "SetEntityState_Request": "gazebo_msgs/EntityState state",
    "SetEntityState_Response": "bool success",
    "ModelStates": "string[] name; geometry_msgs/Pose[] pose; geometry_msgs/Twist[] twist",
    "LinkStates": "string[] name; geometry_msgs/Pose[] pose; geometry_msgs/Twist[] twist",
    "ContactState": "string info; string collision1_name; string collision2_name;"
    " geometry_msgs/Wrench[] wrenches; geometry_msgs/Wrench total_wrench;"
    " geometry_msgs/Vector3[] contact_positions; geometry_msgs/Vector3[] contact_normals;"
    " float64[] depths",
    "ContactsState": "std_msgs/Header header; gazebo_msgs/ContactState[] states",
    "ApplyLinkWrench_Request": "string link_name; string reference_frame;"
    " geometry_msgs/Point reference_point; geometry_msgs/Wrench wrench;"
    " builtin_interfaces/Time start_time; builtin_interfaces/Duration duration",
    "ApplyLinkWrench_Response": _DONE,
    "LinkRequest_Request": "string link_name",
    "LinkRequest_Response": EMPTY,
    "ApplyJointEffort_Request": "string joint_name; float64 effort;"
    " builtin_interfaces/Time start_time; builtin_interfaces/Duration duration",
    "ApplyJointEffort_Response": _DONE,
    "JointRequest_Request": "string joint_name",
    "JointRequest_Response": EMPTY,
    "GetJointProperties_Request": "string joint_name",
    "GetJointProperties_Response": "uint8 type; float64[] damping; float64[] position;"
    f" float64[] rate; {_DONE}",
    "ODEJointProperties": "float64[] damping; float64[] hi_stop; float64[] lo_stop; float64[] erp;"
    " float64[] cfm; float64[] stop_erp; float64[] stop_cfm; float64[] fudge_factor;"
    " float64[] fmax; float64[] vel",
    "SetJointProperties_Request": "string joint_name;"
    " gazebo_msgs/ODEJointProperties ode_joint_config",
    "SetJointProperties_Response": _DONE,
    "GetLinkProperties_Request": "string link_name",
    "GetLinkProperties_Response": f"{_MASSES}; {_DONE}",
    "SetLinkProperties_Request": f"string link_name; {_MASSES}",
    "SetLinkProperties_Response": _DONE,
    "SpawnEntity_Request": "string name; string xml; string robot_namespace;"
    " geometry_msgs/Pose initial_pose; string reference_frame",
    "SpawnEntity_Response": _DONE,
    "DeleteEntity_Request": "string name",
    "DeleteEntity_Response": _DONE,
}
ACTION = {
    "SimulateSteps_Goal": "uint64 steps",
    "SimulateSteps_Result": "simulation_interfaces/Result result",
    "SimulateSteps_Feedback": "uint64 completed_steps; uint64 remaining_steps",
    "SimulateSteps_SendGoal_Request": "unique_identifier_msgs/UUID goal_id;"
    " simulation_interfaces/action/SimulateSteps_Goal goal",
    "SimulateSteps_SendGoal_Response": "bool accepted; builtin_interfaces/Time stamp",
    "SimulateSteps_GetResult_Request": "unique_identifier_msgs/UUID goal_id",
    "SimulateSteps_GetResult_Response": "int8 status;"
    " simulation_interfaces/action/SimulateSteps_Result result",
    "SimulateSteps_FeedbackMessage": "unique_identifier_msgs/UUID goal_id;"
    " simulation_interfaces/action/SimulateSteps_Feedback feedback",
}
"""Messages that rosidl generates for the action."""
CANCEL = {
    "CancelGoal_Request": "action_msgs/GoalInfo goal_info",
    "CancelGoal_Response": "int8 return_code; action_msgs/GoalInfo[] goals_canceling",
}
ZENSIM = {
    "DriveState": "uint32 epoch; uint64 step; uint64 time_ns; uint8[] claims; uint8[] base;"
    " uint8[] joint_positions; uint8[] joint_velocities; uint32 newest_claim; bool is_awaited;"
    " uint8[] twists; uint32 order; uint8[] joint_efforts; TopicFault[] topic_faults",
    "TopicFault": "string[] keys; string kind; float64 value; float64 low; float64 high;"
    " uint64 start_ns; uint64 seed",
    "FleetOdometry": "uint32 epoch; uint64 step; uint64 time_ns; string[] entities;"
    " uint8[] motions; uint8[] joint_positions; bool has_own_tf_rate",
    "AgentCommands": "uint64 taken; uint64 due; float64 taken_hz; float64 due_hz",
    "TwistCommands": "string client; string[] entities; uint8[] twists",
    "DriveCommand": "uint32 epoch; uint64 step; uint8[] claims; uint8[] targets; uint32 order;"
    " bool wants_efforts; uint32 withheld_hz; uint32 rest_ns",
    "SensorsReply": "uint32 epoch; uint64 step; uint64 messages; uint64 late",
    "SensorFigures": "string entity; string sensor; string topic; bool has_subscribers;"
    " uint64 messages; uint64 late; float64 cost_s",
    "SensorStats": "string process; bool is_active; float64 cpu_s; uint64 messages; uint64 late;"
    " zensim/SensorFigures[] sensors",
    "ProcessUsage": "string host; uint32 process_id; float64 wall_s; float64 cpu_s;"
    " uint64 memory_bytes",
    "AgentStats": "string agent; uint32 robots; uint64 states; uint64 malformed;"
    " ProcessUsage usage",
    "VehicleStatus": "string entity; string order; string task; string last_node; string goal;"
    " float64 battery_percent; string[] errors; uint8[] route",
    "FleetStatus": "VehicleStatus[] vehicles",
    "SceneState": "uint32 epoch; uint64 step; uint64 time_ns; uint32 roster; uint8[] poses;"
    " uint8[] joint_positions; string[] processes; bool is_awaited; TopicFault[] topic_faults",
    "Contacts": "uint32 epoch; uint64 step; uint64 time_ns; string[] entities;"
    " string[] collisions; uint8[] bodies; uint8[] points",
    "SimulateSteps_Request": "uint64 steps; string goal_id",
    "CancelSteps_Request": "string goal_id",
    "CancelSteps_Response": "simulation_interfaces/Result result; string[] goal_ids",
    "RunTo_Request": "builtin_interfaces/Time time",
    "RunTo_Response": "simulation_interfaces/Result result; builtin_interfaces/Time time;"
    " uint64 completed_steps",
    "SetSpeed_Request": "float64 real_time_factor",
    "SetSpeed_Response": "simulation_interfaces/Result result",
    "Info_Request": EMPTY,
    "CastRays_Request": "geometry_msgs/Point[] origins; geometry_msgs/Vector3[] directions;"
    " float64 range_max_m; string ignored_entity",
    "CastRays_Response": "simulation_interfaces/Result result; float64[] ranges; string[] entities",
    "GetMap_Request": "float64 resolution_m; float64 low_m; float64 high_m",
    "GetMap_Response": "simulation_interfaces/Result result; nav_msgs/OccupancyGrid map",
    "GetModels_Request": "string[] entities; bool wants_descriptions",
    "InjectFault_Request": "string entity; string kind; string part; float64 value; float64 low;"
    " float64 high; builtin_interfaces/Duration duration; uint64 seed",
    "AuditRecord": "string action; string user; string role; string service; string subject;"
    " string reason; string address; uint64 count; uint64 time_ns",
    "InjectFault_Response": "simulation_interfaces/Result result",
    "MissingAssets_Request": "string[] sha256s",
    "MissingAssets_Response": "simulation_interfaces/Result result; string[] missing;"
    " uint64[] received",
    "PutAsset_Request": "string sha256; uint64 offset; uint64 total; uint8[] data",
    "PutAsset_Response": "simulation_interfaces/Result result; uint64 received",
    "GetAsset_Request": "string sha256; uint64 offset",
    "GetAsset_Response": "simulation_interfaces/Result result; uint8[] data; uint64 total",
}
"""Messages of zensim that are expressible in CDR."""

RCL = {
    "GetParameters_Request": "string[] names",
    "GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "GetParameterTypes_Request": "string[] names",
    "GetParameterTypes_Response": "uint8[] types",
    "SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "SetParametersAtomically_Request": "rcl_interfaces/Parameter[] parameters",
    "SetParametersAtomically_Response": "rcl_interfaces/SetParametersResult result",
    "ListParameters_Request": "string[] prefixes; uint64 depth",
    "ListParameters_Response": "rcl_interfaces/ListParametersResult result",
    "DescribeParameters_Request": "string[] names",
    "DescribeParameters_Response": "rcl_interfaces/ParameterDescriptor[] descriptors",
}
"""Parameter services of each node."""
DESCRIPTIONS = {
    "FieldType": "uint8 type_id; uint64 capacity; uint64 string_capacity;"
    " string<=255 nested_type_name",
    "Field": "string name; type_description_interfaces/FieldType type; string default_value",
    "IndividualTypeDescription": "string<=255 type_name;"
    " type_description_interfaces/Field[] fields",
    "TypeDescription": "type_description_interfaces/IndividualTypeDescription type_description;"
    " type_description_interfaces/IndividualTypeDescription[] referenced_type_descriptions",
    "TypeSource": "string type_name; string encoding; string raw_file_contents",
    "KeyValue": "string key; string value",
    "GetTypeDescription_Request": "string type_name; string type_hash; bool include_type_sources",
    "GetTypeDescription_Response": "bool successful; string failure_reason;"
    " type_description_interfaces/TypeDescription type_description;"
    " type_description_interfaces/TypeSource[] type_sources;"
    " type_description_interfaces/KeyValue[] extra_information",
}

TRAJECTORY = {
    "msg/JointTolerance": "string name; float64 position; float64 velocity; float64 acceleration",
    "msg/JointComponentTolerance": "string joint_name; uint16 component; float64 position;"
    " float64 velocity; float64 acceleration",
    "action/FollowJointTrajectory_Goal": "trajectory_msgs/JointTrajectory trajectory;"
    " trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory;"
    " control_msgs/JointTolerance[] path_tolerance;"
    " control_msgs/JointComponentTolerance[] component_path_tolerance;"
    " control_msgs/JointTolerance[] goal_tolerance;"
    " control_msgs/JointComponentTolerance[] component_goal_tolerance;"
    " builtin_interfaces/Duration goal_time_tolerance",
    "action/FollowJointTrajectory_Result": "int32 error_code; string error_string",
    "action/FollowJointTrajectory_Feedback": "std_msgs/Header header; string[] joint_names;"
    " trajectory_msgs/JointTrajectoryPoint desired; trajectory_msgs/JointTrajectoryPoint actual;"
    " trajectory_msgs/JointTrajectoryPoint error; string[] multi_dof_joint_names;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error",
    "action/FollowJointTrajectory_SendGoal_Request": "unique_identifier_msgs/UUID goal_id;"
    " control_msgs/action/FollowJointTrajectory_Goal goal",
    "action/FollowJointTrajectory_SendGoal_Response": "bool accepted;"
    " builtin_interfaces/Time stamp",
    "action/FollowJointTrajectory_GetResult_Request": "unique_identifier_msgs/UUID goal_id",
    "action/FollowJointTrajectory_GetResult_Response": "int8 status;"
    " control_msgs/action/FollowJointTrajectory_Result result",
    "action/FollowJointTrajectory_FeedbackMessage": "unique_identifier_msgs/UUID goal_id;"
    " control_msgs/action/FollowJointTrajectory_Feedback feedback",
}
"""Of control_msgs, as in humble and jazzy."""

RANGE_SINCE_IRON = (
    "std_msgs/Header header; uint8 radiation_type; float32 field_of_view; float32 min_range;"
    " float32 max_range; float32 range; float32 variance"
)


def define(name: str, fields: str) -> None:
    """Define a type; fields as in an interface file, separated by semicolons."""
    HUMBLE.register(get_types_from_msg(fields.replace(";", "\n"), name))


for _name, _fields in SIMULATION_INTERFACES.items():
    define(f"simulation_interfaces/msg/{_name}", _fields)
for _name, _fields in GAZEBO.items():
    define(f"gazebo_msgs/msg/{_name}", _fields)
for _name in ("Empty_Request", "Empty_Response"):
    define(f"std_srvs/msg/{_name}", EMPTY)
for _name, _fields in ACTION.items():
    define(f"simulation_interfaces/action/{_name}", _fields)
for _name, _fields in CANCEL.items():
    define(f"action_msgs/msg/{_name}", _fields)
HUMBLE.fielddefs.pop("sensor_msgs/msg/Range")
define("sensor_msgs/msg/Range", RANGE_SINCE_IRON)
define(
    "ros_gz_interfaces/msg/Altimeter",
    "std_msgs/Header header; float64 vertical_position; float64 vertical_velocity;"
    " float64 vertical_reference",
)
for _name, _fields in RCL.items():
    define(f"rcl_interfaces/msg/{_name}", _fields)
for _name, _fields in TRAJECTORY.items():
    define(f"control_msgs/{_name}", _fields)
for _name, _fields in DESCRIPTIONS.items():
    define(f"type_description_interfaces/msg/{_name}", _fields)
for _name, _fields in ZENSIM.items():
    define(f"zensim/msg/{_name}", _fields)


def knows(ros_type: str) -> bool:
    return message_name(ros_type) in HUMBLE.types


def ros_bytes(message: msgspec.Struct, ros_type: str, *, little_endian: bool = True) -> bytes:
    """Encode with the oracle."""
    name = message_name(ros_type)
    written = HUMBLE.serialize_cdr(as_ros(message, name), name, little_endian=little_endian)
    return bytes(written)


def rewritten_by_ros(payload: bytes, ros_type: str) -> bytes:
    """Decode and encode again with the oracle."""
    name = message_name(ros_type)
    return bytes(HUMBLE.serialize_cdr(HUMBLE.deserialize_cdr(payload, name), name))


def message_name(ros_type: str) -> str:
    return ros_type.replace("/srv/", "/msg/")


def as_ros(message: msgspec.Struct, name: str) -> object:
    fields: dict[str, Any] = {
        field: _ros_value(getattr(message, field, 0), description)
        for field, description in HUMBLE.get_msgdef(name).fields
    }
    return HUMBLE.types[name](**fields)


def _ros_value(value: object, description: object) -> object:
    match description:
        case (Nodetype.NAME, str(name)):
            assert isinstance(value, msgspec.Struct)
            return as_ros(value, name)
        case (Nodetype.ARRAY | Nodetype.SEQUENCE, ((Nodetype.BASE, (str(kind), _)), _)):
            if kind == "string":
                return value
            if isinstance(value, bytes):
                return np.frombuffer(value, dtype=kind)
            return np.array(list(value), dtype=kind)  # type: ignore[call-overload]
        case (Nodetype.SEQUENCE, ((Nodetype.NAME, str(name)), _)):
            assert isinstance(value, tuple)
            return [as_ros(item, name) for item in value]
        case _:
            return value
