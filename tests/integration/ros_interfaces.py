"""Interface definitions; fields are separated by semicolons, requests and responses by dashes.

Source: simulation_interfaces 1.x and 2.1, gazebo_msgs, std_srvs, action_msgs, control_msgs. Hashes
are the published ones. For actions, goal, result and feedback replace their wrapper types.
"""

SPAWN_V1 = "simulation_interfaces/srv/SpawnEntity@1"
"""Two versions share this type name; the suffix after @ is local."""
INTERFACES = {
    SPAWN_V1: "string name; bool allow_renaming; string uri; string resource_string;"
    " string entity_namespace; geometry_msgs/PoseStamped initial_pose"
    "---simulation_interfaces/Result result; string entity_name",
    "simulation_interfaces/srv/SpawnEntity": "string name; bool allow_renaming;"
    " simulation_interfaces/Resource entity_resource; string entity_namespace;"
    " geometry_msgs/PoseStamped initial_pose"
    "---simulation_interfaces/Result result; string entity_name",
    "simulation_interfaces/srv/DeleteEntity": "string entity---simulation_interfaces/Result result",
    "simulation_interfaces/srv/GetEntities": "simulation_interfaces/EntityFilters filters"
    "---simulation_interfaces/Result result; string[] entities",
    "simulation_interfaces/srv/GetEntityState": "string entity"
    "---simulation_interfaces/Result result; simulation_interfaces/EntityState state",
    "simulation_interfaces/srv/SetEntityState": "string entity;"
    " simulation_interfaces/EntityState state---simulation_interfaces/Result result",
    "simulation_interfaces/srv/GetSpawnables": "string[] sources"
    "---simulation_interfaces/Result result; simulation_interfaces/Spawnable[] spawnables",
    "gazebo_msgs/srv/SpawnEntity": "string name; string xml; string robot_namespace;"
    " geometry_msgs/Pose initial_pose; string reference_frame"
    "---bool success; string status_message",
    "gazebo_msgs/srv/DeleteEntity": "string name---bool success; string status_message",
    "gazebo_msgs/srv/GetModelList": "uint8 structure_needs_at_least_one_member"
    "---std_msgs/Header header; string[] model_names; bool success",
    "simulation_interfaces/action/SimulateSteps_SendGoal": "unique_identifier_msgs/UUID goal_id;"
    " uint64 steps---bool accepted; builtin_interfaces/Time stamp",
    "simulation_interfaces/action/SimulateSteps_GetResult": "unique_identifier_msgs/UUID goal_id"
    "---int8 status; simulation_interfaces/Result result",
    "simulation_interfaces/action/SimulateSteps_FeedbackMessage": ""
    "unique_identifier_msgs/UUID goal_id; uint64 completed_steps; uint64 remaining_steps",
    "control_msgs/action/FollowJointTrajectory_SendGoal": "unique_identifier_msgs/UUID goal_id;"
    " trajectory_msgs/JointTrajectory trajectory;"
    " trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory;"
    " control_msgs/JointTolerance[] path_tolerance;"
    " control_msgs/JointComponentTolerance[] component_path_tolerance;"
    " control_msgs/JointTolerance[] goal_tolerance;"
    " control_msgs/JointComponentTolerance[] component_goal_tolerance;"
    " builtin_interfaces/Duration goal_time_tolerance"
    "---bool accepted; builtin_interfaces/Time stamp",
    "control_msgs/action/FollowJointTrajectory_GetResult": "unique_identifier_msgs/UUID goal_id"
    "---int8 status; int32 error_code; string error_string",
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": ""
    "unique_identifier_msgs/UUID goal_id; std_msgs/Header header; string[] joint_names;"
    " trajectory_msgs/JointTrajectoryPoint desired; trajectory_msgs/JointTrajectoryPoint actual;"
    " trajectory_msgs/JointTrajectoryPoint error; string[] multi_dof_joint_names;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual;"
    " trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error",
    "action_msgs/srv/CancelGoal": "action_msgs/GoalInfo goal_info"
    "---int8 return_code; action_msgs/GoalInfo[] goals_canceling",
    "std_srvs/srv/Empty": "uint8 structure_needs_at_least_one_member"
    "---uint8 structure_needs_at_least_one_member",
}
SPAWN_V2_HASH = "RIHS01_66860313e11009faddbfc8568e5d410d1a11607fe75eeb1308671dc0406fe3a7"
SPAWN_V1_HASH = "RIHS01_d4c086345d4194a5fc4c9ae45095736ca4062b5cdac4d06a42dec93d683e03cf"
DELETE_HASH = "RIHS01_ff7e96a5b83dc8e2bb34b8b034480028b3a24d9f8376b2c0590bac3704be3e28"
GET_ENTITIES_HASH = "RIHS01_cb90004c48cd50f37732fb008e22c34c261dd680a723bf0f85d8437ea4498bf7"
GET_STATE_HASH = "RIHS01_749c91f2a2353d98367b64f2995a0f5842ce92a08ec1ffb3e185540a91557fb5"
SET_STATE_V1_HASH = "RIHS01_ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e"
GET_SPAWNABLES_V1_HASH = "RIHS01_3bc0266bf8236058ff589c44512e013afe4f295427c39d44cff363d1c956bf36"
OF_HUMBLE = "TypeHashNotSupported"
