"""The script for users of ROS 2, run against programs that print what ROS 2 prints."""

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
PYTHON = r"""#!/bin/sh
shift
case "$*" in
  frames) echo '150 frames of 10 robots under world after 0.31 s' ;;
  "square r1") echo 'square of 1.6 m closed to 0.018 m in 12.1 s of /clock' ;;
  "clients /r1/agent/list_parameters 200")
    printf '%s calls had a reply\n' 1 2
    echo 'all 200 calls of clients in turn had a reply' ;;
  "spawn 10") echo '10 robots spawned, slowest reply 20 ms' ;;
  "resume r1") printf 'ready\nheard again 4.0 s after the simulator ended\n' ;;
esac
"""
SEPARATOR = "# another program\n"
PROGRAMS = f"{ROS2}{SEPARATOR}{PYTHON}"
FAULTS = {
    "no node": ("'/zensim\\n/r1/agent\\n'", "'/zensim\\n'", "nodes are listed"),
    "one type of cmd_vel": (", geometry_msgs/msg/TwistStamped", "", "cmd_vel has both types"),
    "best effort": ("Reliability: RELIABLE", "Reliability: BEST_EFFORT", "odom is reliable"),
    "robot stands": ('"x: $(wc -l <"$counter")"', "'x: 1.0'", "the robot moved"),
    "no parameters": ("echo 'Boolean value is: True'", "exit 1", "a parameter is read"),
    "nodes are deaf": ("data: heard", "no", "two nodes hear each other"),
    "no transform": ("- Translation", "- Failure", "tf2 finds the frame of the robot"),
    "lost frames": ("frames) echo", "frames) exit 1; echo", "a late listener has all frames"),
    "open square": ("'square of", "'it ends", "the robot closes a square in simulation time"),
    "no spawn": ("'10 robots", "'no", "ten robots are spawned, driven and deleted"),
    "no reply": ("printf '%s calls had a reply", "exit 1 #", "a client of a service gets a reply"),
    "goal aborted": ("status: SUCCEEDED", "status: ABORTED", "steps have feedback and succeed"),
}


def run_check(folder: Path, programs: str, *options: str) -> "subprocess.CompletedProcess[str]":
    for name, text in zip(("ros2", "python3"), programs.split(SEPARATOR), strict=True):
        program = folder / name
        program.write_text(text)
        program.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "RMW_IMPLEMENTATION": "rmw_zenoh_cpp",
    }
    return subprocess.run(
        ["bash", str(SCRIPT), *options, "r1"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=environment,
    )


def test_script_prints_one_line_a_check(tmp_path: Path) -> None:
    done = run_check(tmp_path, PROGRAMS)

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
    assert expected in PROGRAMS

    done = run_check(tmp_path, PROGRAMS.replace(expected, printed))

    assert done.returncode == 1
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    assert [line.split(":")[0] for line in failed] == [f"FAIL  {check}"]


def test_script_counts_no_call_that_hangs_after_a_reply(tmp_path: Path) -> None:
    hanging = PROGRAMS.replace("echo 'all 200 calls of clients in turn had a reply'", "exit 1")

    done = run_check(tmp_path, hanging)

    assert done.returncode == 0, done.stdout
    assert "note  clients of services that come and go: 2 calls had a reply" in done.stdout


@pytest.mark.parametrize(
    ("command", "printed", "status"),
    [("true", "heard again", 0), ("false", "heard again", 1), ("true", "no odometry", 1)],
)
def test_script_restarts_the_simulator_while_a_node_listens(
    tmp_path: Path, command: str, printed: str, status: int
) -> None:
    restart = f"touch {tmp_path / 'restarted'} && {command}"

    done = run_check(tmp_path, PROGRAMS.replace("heard again", printed), "--restart", restart)

    assert done.returncode == status, done.stdout
    assert (tmp_path / "restarted").exists()
    assert f"{'FAIL' if status else 'ok  '}  a node goes on after a restart" in done.stdout


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
