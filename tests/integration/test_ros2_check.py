"""The script for users of ROS 2, run against a program that prints what `ros2` prints."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "examples" / "ros2_check.sh"
ROS2 = r"""#!/bin/sh
counter="$(dirname "$0")/moves"
case "$*" in
  "pkg xml rclpy"*) echo 7.1.6 ;;
  "pkg prefix"*) echo /opt/ros ;;
  "run tf2_ros"*) echo '- Translation: [0.000, 0.000, 0.000]' ;;
  *"/zensim_check std_msgs/msg/String") echo 'data: heard' ;;
  "interface show"*) echo 'string uri' ;;
  *"srv/SpawnEntity "*) echo "response: Response(result=Result(result=1, error_message=''))" ;;
  *"srv/DeleteEntity "*) echo "response: Response(result=Result(result=1))" ;;
  "node list") printf '/zensim\n/r1/agent\n' ;;
  "topic list -t") printf '%s\n' '/clock [rosgraph_msgs/msg/Clock]' \
    '/r1/cmd_vel [geometry_msgs/msg/Twist, geometry_msgs/msg/TwistStamped]' \
    '/r1/odom [nav_msgs/msg/Odometry]' ;;
  "service list") echo /reset_simulation ;;
  "node info"*) echo '    /r1/odom: nav_msgs/msg/Odometry' ;;
  "topic info"*) printf 'Reliability: RELIABLE\nDurability: TRANSIENT_LOCAL\n' ;;
  *"pose.pose.position"*)
    echo x >>"$counter"
    echo "x: $(wc -l <"$counter")"
    printf 'y: 0.0\nz: 0.0\n---\n' ;;
  "topic echo"*) printf 'nanosec: 5\nchild_frame_id: base_link\ndata: <robot/>\n' ;;
  "topic pub"*) echo 'publishing #1: geometry_msgs.msg.Twist()' ;;
  "param list") printf '/r1/agent:\n  use_sim_time\n' ;;
  "param get"*) echo 'Boolean value is: True' ;;
  "param dump"*) echo '    use_sim_time: true' ;;
  "service call"*) echo "response: r1 features=[]" ;;
  "action send_goal"*) echo 'Goal finished with status: SUCCEEDED' ;;
esac
"""
FAULTS = {
    "no node": ("'/zensim\\n/r1/agent\\n'", "'/zensim\\n'", "nodes are listed"),
    "one type of cmd_vel": (", geometry_msgs/msg/TwistStamped", "", "cmd_vel has both types"),
    "best effort": ("Reliability: RELIABLE", "Reliability: BEST_EFFORT", "odom is reliable"),
    "robot stands": ('"x: $(wc -l <"$counter")"', "'x: 1.0'", "the robot moved"),
    "no parameters": ("echo 'Boolean value is: True'", "exit 1", "a parameter is read"),
    "nodes are deaf": ("data: heard", "no", "two nodes hear each other"),
    "no transform": ("- Translation", "- Failure", "tf2 finds the frame of the robot"),
    "no spawn": ("result=1,", "result=101,", "ten robots are spawned"),
    "goal aborted": ("status: SUCCEEDED", "status: ABORTED", "steps have feedback and succeed"),
}


def run_check(folder: Path, ros2: str) -> "subprocess.CompletedProcess[str]":
    program = folder / "ros2"
    program.write_text(ros2)
    program.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "RMW_IMPLEMENTATION": "rmw_zenoh_cpp",
    }
    return subprocess.run(
        ["bash", str(SCRIPT), "r1"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=environment,
    )


def test_script_prints_one_line_a_check(tmp_path: Path) -> None:
    done = run_check(tmp_path, ROS2)

    notes = [line for line in done.stdout.splitlines() if line.startswith("note")]
    *lines, total = [line for line in done.stdout.splitlines() if line not in notes]
    assert done.returncode == 0, done.stdout
    assert any(line.startswith("note  rclpy 7.1.6") for line in notes)
    assert {line.split()[0] for line in lines} == {"ok"}
    assert total == f"{len(lines)} passed, 0 failed"


@pytest.mark.parametrize(("expected", "printed", "check"), FAULTS.values(), ids=FAULTS)
def test_script_fails_by_the_check_of_a_fault(
    tmp_path: Path, expected: str, printed: str, check: str
) -> None:
    assert expected in ROS2

    done = run_check(tmp_path, ROS2.replace(expected, printed))

    assert done.returncode == 1
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    assert [line.split(":")[0] for line in failed] == [f"FAIL  {check}"]


def test_script_refuses_another_middleware() -> None:
    done = subprocess.run(
        ["bash", str(SCRIPT)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={"PATH": os.environ["PATH"], "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"},
    )

    assert done.returncode == 2
    assert done.stdout == ""
