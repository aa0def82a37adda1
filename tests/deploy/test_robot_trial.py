"""Trials of robots with real engines, in this process: good, odd, undriven and broken ones."""

import re
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from zensim.deploy.robot_checks import RobotCheck, TrialRequest, TrialResult, judge, make_row
from zensim.deploy.robot_trial import run_trial

BOX_BOT = (resources.files("zensim.sim_server") / "models" / "box_bot.urdf").read_text()
PLUGIN = re.compile(r"<gazebo>\s*<plugin[^>]*diff_drive.*?</plugin>\s*</gazebo>", re.DOTALL)
WHEELS = "diff:left_wheel_joint,right_wheel_joint"
BALL = (
    '<robot name="ball"><link name="a"><inertial><mass value="1"/><inertia ixx="1" ixy="0" '
    'ixz="0" iyy="1" iyz="0" izz="1"/></inertial><collision><geometry><box size="1 1 1"/>'
    "</geometry></collision></link></robot>"
)

Try = Callable[..., TrialResult]


@pytest.fixture
def attempt(tmp_path: Path) -> Try:
    """Run a trial of a description."""

    def run(text: str, engine: str = "pybullet", drive: str = "") -> TrialResult:
        file = tmp_path / "robot.urdf"
        file.write_text(text)
        return run_trial(TrialRequest(robot=RobotCheck(str(file), drive=drive), engine=engine))

    return run


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_good_robot_drives_as_commanded(attempt: Try, engine: str) -> None:
    result = attempt(BOX_BOT, engine)

    assert judge(result, 0.05) == ("ok", "")
    assert (result.model, result.drive, result.drive_source) == ("box_bot", "diff_drive", "plug-in")
    assert result.tilt_rad < 0.01
    assert result.creep_m_s < 1e-4


def test_a_good_robot_drives_as_commanded_in_the_kinematic_tier(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(BOX_BOT)
    request = TrialRequest(robot=RobotCheck(str(file)), engine="pybullet", dynamics="kinematic")

    result = run_trial(request)

    row = make_row(request, result, 0.001)
    assert (row.verdict, row.engine) == ("ok", "kinematic")


def test_a_robot_without_a_drive_is_refused_in_the_kinematic_tier(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(BALL)
    robot = RobotCheck(str(file))

    result = run_trial(TrialRequest(robot=robot, engine="pybullet", dynamics="kinematic"))

    assert "kinematic" in result.error
    assert judge(result, 0.05)[0] == "refused"


def test_a_trial_repeats_exactly(attempt: Try) -> None:
    assert attempt(BOX_BOT) == attempt(BOX_BOT)


def test_wheels_of_another_size_deviate_as_predicted(attempt: Try) -> None:
    small = re.sub(r"<wheel_diameter>[^<]*<", "<wheel_diameter>0.14<", BOX_BOT)

    result = attempt(small)

    assert judge(result, 0.05)[0] == "predicted"
    assert result.straight is not None
    assert result.straight.predicted is not None
    assert result.straight.measured[0] == pytest.approx(result.straight.predicted[0], rel=0.05)


def test_wheels_without_a_drive_are_told_the_option(attempt: Try) -> None:
    undriven = PLUGIN.sub("", BOX_BOT)
    assert undriven != BOX_BOT

    verdict, reason = judge(attempt(undriven), 0.05)

    assert verdict == "no drive"
    assert "--drive diff:" in reason


def test_an_ordered_drive_is_used(attempt: Try) -> None:
    result = attempt(PLUGIN.sub("", BOX_BOT), drive=WHEELS)

    assert judge(result, 0.05)[0] == "ok"
    assert result.drive_source == "--drive"


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_what_has_no_wheels_only_stands(attempt: Try, engine: str) -> None:
    result = attempt(BALL, engine)

    assert judge(result, 0.05) == ("stands", "")
    assert result.straight is None


@pytest.mark.parametrize("text", ["<robot", "<robot name='r'/>", BALL.replace('"1 1 1"', '"x"')])
def test_a_broken_description_is_refused(attempt: Try, text: str) -> None:
    assert judge(attempt(text), 0.05)[0] == "refused"


def test_a_drive_that_does_not_fit_is_refused(attempt: Try) -> None:
    assert judge(attempt(BALL, drive=WHEELS), 0.05)[0] == "refused"


def test_a_missing_file_is_refused() -> None:
    request = TrialRequest(robot=RobotCheck("gone/robot.urdf"), engine="pybullet")

    assert judge(run_trial(request), 0.05)[0] == "refused"
