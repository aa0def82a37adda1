"""`zensim check`: folders, engines, exit statuses and files, with real processes."""

import json
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.integration.processes import run_in_process, zensim
from zensim.proto.exit_codes import ExitCode

BOX_BOT = (resources.files("zensim.sim_server") / "models" / "box_bot.urdf").read_text()


@pytest.fixture
def robots(tmp_path: Path) -> Path:
    (tmp_path / "good.urdf").write_text(BOX_BOT)
    (tmp_path / "broken.urdf").write_text('<robot name="broken"><link/></robot>')
    return tmp_path


def test_check_reports_each_robot_of_a_folder_the_same_twice(robots: Path) -> None:
    junit = robots / "check.xml"

    first = zensim("check", str(robots), "--json", "--junit", str(junit), "--jobs", "2")
    second = zensim("check", str(robots), "--json")

    assert first.returncode == second.returncode == ExitCode.FAILED, first.stderr
    assert first.stdout == second.stdout
    rows = json.loads(first.stdout)["rows"]
    assert [(Path(row["robot"]["path"]).name, row["verdict"]) for row in rows] == [
        ("broken.urdf", "refused"),
        ("good.urdf", "ok"),
    ]
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("errors")) == ("2", "1")


def test_check_of_good_robots_with_both_engines_ends_with_ok(robots: Path) -> None:
    done = zensim("check", str(robots), "--exclude", "broken.*", "--engine", "both")

    assert done.returncode == ExitCode.OK, done.stderr
    assert [line.split()[:2] for line in done.stdout.splitlines()[1:3]] == [
        ["box_bot", "pybullet"],
        ["box_bot", "mujoco"],
    ]


def test_check_of_a_robot_that_takes_too_long_has_a_row(robots: Path) -> None:
    done = zensim("check", str(robots / "good.urdf"), "--json", "--trial-timeout", "0.01")

    assert done.returncode == ExitCode.FAILED, done.stderr
    assert json.loads(done.stdout)["verdicts"] == {"timeout": 1}


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("gone",), ExitCode.NOT_FOUND),
        ((".", "--exclude", "*"), ExitCode.NOT_FOUND),
        ((".", "--engine", "abacus"), ExitCode.USAGE),
        ((".", "--compat", "abacus"), ExitCode.USAGE),
        ((".", "--drive", "wings:"), ExitCode.USAGE),
        ((), ExitCode.USAGE),
    ],
)
def test_check_with_wrong_arguments_says_so(
    robots: Path, arguments: tuple[str, ...], status: ExitCode
) -> None:
    given = [str(robots / word) if word in ("gone", ".") else word for word in arguments]

    done = run_in_process("check", *given)

    assert done.returncode == status, done.stdout
    assert done.stderr
