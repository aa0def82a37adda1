#!/usr/bin/env bash
# Checks a running zensim with the command line of ROS 2: one line a check, exit status 1 if one
# fails. Needs ROS 2 with rmw_zenoh_cpp, `timeout` of coreutils, and a zensim with a robot:
#
#   zensim up --robots 10 --behaviour none
#   source /opt/ros/jazzy/setup.bash
#   export RMW_IMPLEMENTATION=rmw_zenoh_cpp
#   examples/ros2_check.sh [--restart COMMAND] [ROBOT]
#
# ROBOT is the namespace of a robot, box_bot0 by default. COMMAND ends the simulator and starts it
# again, while a node listens. For a simulator on another host, set ZENOH_CONFIG_OVERRIDE first, as
# docs/ros2.md says. What needs rclpy is in ros2_check.py beside this file.
set -u

restart=''
if [ "${1:-}" = --restart ]; then
  restart="${2:?a command that restarts the simulator}"
  shift 2
fi
readonly ROBOT="${1:-box_bot0}"
readonly LIMIT_S=30 CYCLES=200
readonly PROGRAM="${BASH_SOURCE[0]%/*}/ros2_check.py"
passed=0
failed=0
output=''

# report STATUS NAME DETAIL: prints the line of a check, and counts it.
report() {
  if [ "$1" -eq 0 ]; then
    passed=$((passed + 1))
    printf 'ok    %s\n' "$2"
  else
    failed=$((failed + 1))
    printf 'FAIL  %s: %s\n' "$2" "$3"
  fi
}

# check NAME PATTERN COMMAND...: the command has to end with status 0 within LIMIT_S and to print a
# line that matches the extended regular expression.
check() {
  local name="$1" pattern="$2" status
  shift 2
  output="$(timeout "$LIMIT_S" "$@" 2>&1)"
  status=$?
  if [ "$status" -ne 0 ]; then
    report 1 "$name" "status $status of: $*; ${output##*$'\n'}"
  elif ! grep -Eq -- "$pattern" <<<"$output"; then
    report 1 "$name" "no line of: $* matches $pattern"
  else
    report 0 "$name" ''
  fi
}

# check_within SECONDS NAME PATTERN COMMAND...: the same, with a limit of wall time.
check_within() {
  local limit="$1" began=$SECONDS failed_before=$failed
  shift
  check "$@"
  if [ "$failed" -eq "$failed_before" ] && [ $((SECONDS - began)) -gt "$limit" ]; then
    passed=$((passed - 1))
    report 1 "$1" "took $((SECONDS - began)) s, at most $limit expected"
  fi
}

for program in ros2 python3 timeout; do
  if ! command -v "$program" >/dev/null; then
    printf 'ros2_check: %s is not installed, or its setup.bash is not sourced\n' "$program" >&2
    exit 2
  fi
done
if [ "${RMW_IMPLEMENTATION:-}" != rmw_zenoh_cpp ]; then
  printf 'ros2_check: set RMW_IMPLEMENTATION=rmw_zenoh_cpp\n' >&2
  exit 2
fi
# A daemon that runs has the settings of the shell that started it.
ros2 daemon stop >/dev/null 2>&1

# Versions, for reports: of a package that is not installed there is none.
for package in ros2cli rclpy rmw_zenoh_cpp tf2 simulation_interfaces; do
  printf 'note  %s %s, %s\n' "$package" \
    "$(timeout "$LIMIT_S" ros2 pkg xml "$package" --tag version 2>/dev/null || echo missing)" \
    "${ROS_DISTRO:-unknown distribution}"
done

has_interface() {
  ros2 interface show "$1" >/dev/null 2>&1
}

# read_position: prints x and y of the robot.
read_position() {
  timeout "$LIMIT_S" ros2 topic echo --once --field pose.pose.position "/$ROBOT/odom" 2>/dev/null |
    awk '/^x:/ {x = $2} /^y:/ {y = $2} END {if (x != "") print x, y}'
}

# is_moved BEFORE AFTER: whether two positions are at least 0.2 m apart.
is_moved() {
  awk -v before="$1" -v after="$2" 'BEGIN {
    if (split(before, b) != 2 || split(after, a) != 2) exit 1
    exit !((a[1] - b[1]) ^ 2 + (a[2] - b[2]) ^ 2 >= 0.04)
  }'
}

# The graph.
check 'nodes are listed' "^/$ROBOT/agent$" ros2 node list
check 'the server is a node' '^/zensim$' ros2 node list
check 'topics are listed with types' "^/$ROBOT/odom \[nav_msgs/msg/Odometry\]" ros2 topic list -t
check 'the clock is listed' '^/clock \[rosgraph_msgs/msg/Clock\]' ros2 topic list -t
check 'cmd_vel has both types' \
  "^/$ROBOT/cmd_vel \[geometry_msgs/msg/Twist, geometry_msgs/msg/TwistStamped\]" \
  ros2 topic list -t
check 'services are listed' '^/reset_simulation$' ros2 service list
check 'the node has publishers' "/$ROBOT/odom: nav_msgs/msg/Odometry" \
  ros2 node info "/$ROBOT/agent"
check 'odom is reliable' 'Reliability: RELIABLE' ros2 topic info -v "/$ROBOT/odom"
check 'tf_static is latched' 'Durability: TRANSIENT_LOCAL' \
  ros2 topic info -v "/$ROBOT/tf_static"
check 'the description is latched' 'Durability: TRANSIENT_LOCAL' \
  ros2 topic info -v "/$ROBOT/robot_description"

# Messages.
check 'clock arrives' 'nanosec: [0-9]+' ros2 topic echo --once /clock
check 'odom arrives' "child_frame_id: [\"']?[a-z]" ros2 topic echo --once "/$ROBOT/odom"
check 'tf arrives' 'child_frame_id:' ros2 topic echo --once /tf
check 'tf_static arrives late' 'child_frame_id:' \
  ros2 topic echo --once --qos-durability transient_local --qos-reliability reliable \
  "/$ROBOT/tf_static"
check 'the description arrives late' 'robot' \
  ros2 topic echo --once --qos-durability transient_local --qos-reliability reliable \
  "/$ROBOT/robot_description"

# Two nodes of ROS 2, which see each other through the simulator's router.
timeout "$LIMIT_S" ros2 topic pub --rate 5 /zensim_check std_msgs/msg/String '{data: heard}' \
  >/dev/null 2>&1 &
talker=$!
check 'two nodes hear each other' 'data: heard' \
  ros2 topic echo --once /zensim_check std_msgs/msg/String
kill "$talker" 2>/dev/null
wait "$talker" 2>/dev/null
if ros2 pkg prefix tf2_ros >/dev/null 2>&1; then
  # It does not end by itself.
  output="$(timeout 10 ros2 run tf2_ros tf2_echo world "$ROBOT/odom" 2>&1)"
  grep -q 'Translation:' <<<"$output"
  report $? 'tf2 finds the frame of the robot' "no transform from world to $ROBOT/odom in 10 s"
fi
check 'a late listener has all frames' ' under world after ' python3 "$PROGRAM" frames

# Commands.
before="$(read_position)"
check 'Twist is published' 'publishing' \
  ros2 topic pub --times 20 --rate 10 "/$ROBOT/cmd_vel" geometry_msgs/msg/Twist \
  '{linear: {x: 0.2}}'
after="$(read_position)"
is_moved "$before" "$after"
report $? 'the robot moved' "by less than 0.2 m, from ${before:-nowhere} to ${after:-nowhere}"
check 'TwistStamped is published' 'publishing' \
  ros2 topic pub --times 5 --rate 10 "/$ROBOT/cmd_vel" geometry_msgs/msg/TwistStamped \
  '{twist: {angular: {z: 0.5}}}'
check 'the robot closes a square in simulation time' '^square of ' \
  python3 "$PROGRAM" square "$ROBOT"

# Parameters.
check_within 10 'parameters of all nodes are listed' 'use_sim_time' ros2 param list
check 'a parameter is read' 'True' ros2 param get "/$ROBOT/agent" use_sim_time
check 'parameters are dumped' 'use_sim_time: true' ros2 param dump "/$ROBOT/agent"

# Services and the action; these types are in the package simulation_interfaces.
check 'physics pauses' 'response' ros2 service call /pause_physics std_srvs/srv/Empty
if has_interface simulation_interfaces/srv/GetEntities; then
  check 'entities are listed' "$ROBOT" \
    ros2 service call /get_entities simulation_interfaces/srv/GetEntities
  check 'features are listed' 'features=' \
    ros2 service call /get_simulator_features simulation_interfaces/srv/GetSimulatorFeatures
  check 'steps have feedback and succeed' 'SUCCEEDED' \
    ros2 action send_goal --feedback /simulate_steps \
    simulation_interfaces/action/SimulateSteps '{steps: 240}'
else
  printf 'note  simulation_interfaces is not installed: its services were not called\n'
fi
check 'physics goes on' 'response' ros2 service call /unpause_physics std_srvs/srv/Empty

if has_interface simulation_interfaces/srv/SpawnEntity; then
  check 'ten robots are spawned, driven and deleted' '^10 robots spawned' \
    python3 "$PROGRAM" spawn 10
fi

# A process may hang by a fault of rmw_zenoh_cpp: docs/ros2.md, "Clients of services that come and
# go". What counts here is that the server replied until then.
output="$(timeout "$LIMIT_S" python3 "$PROGRAM" clients "/$ROBOT/agent/list_parameters" "$CYCLES")"
status=$?
printf 'note  clients of services that come and go: %s\n' "${output##*$'\n'}"
[ "$status" -eq 0 ] || grep -q 'had a reply' <<<"$output"
report $? 'a client of a service gets a reply' "${output##*$'\n'}"

# restart_while_heard: restarts the simulator under a node that listens.
restart_while_heard() {
  local line
  exec 3< <(timeout 150 python3 "$PROGRAM" resume "$ROBOT" 2>&1)
  read -r line <&3 && [ "$line" = ready ] && eval "$restart" >/dev/null 2>&1 && read -r line <&3
  output="$line"
  exec 3<&-
  grep -q '^heard again' <<<"$output"
}
if [ -n "$restart" ]; then
  restart_while_heard
  report $? 'a node goes on after a restart of the simulator' "$output"
fi

printf '%s passed, %s failed\n' "$passed" "$failed"
[ "$failed" -eq 0 ]
