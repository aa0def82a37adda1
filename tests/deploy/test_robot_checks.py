"""Descriptions that a check finds, verdicts on what robots did, and rows of failed trials."""

import json
from pathlib import Path

import msgspec
import pytest

from zensim.deploy.robot_checks import (
    DrivenPart,
    RobotCheck,
    TrialRequest,
    TrialResult,
    Verdict,
    find_robots,
    judge,
    run_checks,
    run_trial_process,
)

ROBOT = '<robot name="r"><link name="a"/></robot>'
PART = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/></robot>'
STRAIGHT = DrivenPart((0.2, 0.0, 0.0), (0.2, 0.0, 0.0))
TURN = DrivenPart((0.0, 0.0, 0.5), (0.0, 0.0, 0.5))
DRIVEN = TrialResult(model="r", drive="diff_drive", straight=STRAIGHT, turn=TURN)
REQUEST = TrialRequest(robot=RobotCheck("r.urdf"), engine="pybullet")


def names_in(folder: Path, *excluded: str) -> list[str]:
    return [Path(robot.path).name for robot in find_robots([folder], excluded)]


def make_folder(folder: Path) -> Path:
    for name, text in (
        ("b.urdf", ROBOT),
        ("a.urdf.xacro", ROBOT),
        ("part.xacro", PART),
        ("notes.txt", ROBOT),
        ("test/c.urdf", ROBOT),
        ("model.sdf", '<sdf version="1.9"><model name="m"/></sdf>'),
        ("place.sdf", '<sdf version="1.9"><world name="w"><model name="m"/></world></sdf>'),
        (".git/d.urdf", ROBOT),
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_robots_of_a_folder_are_found_without_parts_and_worlds(tmp_path: Path) -> None:
    assert names_in(make_folder(tmp_path)) == ["a.urdf.xacro", "b.urdf", "model.sdf", "c.urdf"]


def test_excluded_files_and_folders_are_left_out(tmp_path: Path) -> None:
    assert names_in(make_folder(tmp_path), "test", "*.sdf") == ["a.urdf.xacro", "b.urdf"]


def test_a_file_is_taken_whatever_its_suffix_and_once(tmp_path: Path) -> None:
    file = make_folder(tmp_path) / "notes.txt"

    assert len(find_robots([file, file], ())) == 1


def test_a_missing_path_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        find_robots([tmp_path / "gone"], ())


def test_paths_of_a_list_are_relative_to_it(tmp_path: Path) -> None:
    listed = tmp_path / "robots.json"
    listed.write_text(
        json.dumps([{"path": "a/r.urdf", "package_paths": ["a"], "controllers": ["c.yaml"]}])
    )

    (robot,) = find_robots([listed], ())

    assert robot.path == str(tmp_path / "a" / "r.urdf")
    assert robot.package_paths == (str(tmp_path / "a"),)
    assert robot.controllers == (str(tmp_path / "c.yaml"),)


@pytest.mark.parametrize("text", ["{", "[1]", '[{"path": "r.urdf", "colour": "red"}]'])
def test_a_list_that_is_not_valid_is_refused(tmp_path: Path, text: str) -> None:
    listed = tmp_path / "robots.json"
    listed.write_text(text)

    with pytest.raises(ValueError, match=r"robots\.json"):
        find_robots([listed], ())


def moved(part: DrivenPart, *measured: float, predicted: bool = False) -> DrivenPart:
    vx, vy, wz = measured
    return DrivenPart(part.commanded, (vx, vy, wz), (vx, vy, wz) if predicted else None)


STILL = moved(TURN, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "ok"),
        ({"straight": moved(STRAIGHT, 0.18, 0.0, 0.0)}, "off"),
        ({"straight": moved(STRAIGHT, 0.2, 0.0, 0.1)}, "off"),
        ({"turn": moved(TURN, 0.0, 0.0, 0.2)}, "off"),
        ({"turn": moved(TURN, 0.0, 0.0, 0.2, predicted=True)}, "off"),
        (
            {
                "straight": moved(STRAIGHT, 0.2, 0.0, 0.0, predicted=True),
                "turn": moved(TURN, 0.0, 0.0, 0.2, predicted=True),
            },
            "predicted",
        ),
        ({"tilt_rad": 0.2}, "off"),
        ({"creep_m_s": 0.01}, "off"),
        ({"turn": STILL, "shift": (0.0, 0.0, -9.0), "remarks": ("it falls: …",)}, "predicted"),
        ({"turn": STILL, "tilt_rad": 0.2, "remarks": ("it sinks: …",)}, "predicted"),
        ({"turn": STILL, "remarks": ("it falls: …",)}, "off"),
        ({"turn": STILL, "shift": (0.0, 0.0, -9.0)}, "off"),
        ({"has_diverged": True}, "unstable"),
        ({"error": "urdf.number: ..."}, "refused"),
        ({"error": "TypeError: ...", "is_fault": True}, "crashed"),
        ({"straight": None, "turn": None}, "stands"),
        ({"straight": None, "turn": None, "tilt_rad": 1.8}, "predicted"),
        ({"straight": None, "turn": None, "shift": (0.0, 0.0, -9.0)}, "unstable"),
        ({"straight": None, "turn": None, "remarks": ("no drive: …",)}, "no drive"),
    ],
)
def test_verdict_on(changes: dict[str, object], verdict: Verdict) -> None:
    found, reason = judge(msgspec.structs.replace(DRIVEN, **changes), 0.05)

    assert found == verdict
    assert bool(reason) == (verdict not in ("ok", "stands"))


def test_a_trial_that_crashes_or_hangs_ends_no_other() -> None:
    outcomes: dict[str, TrialResult | int] = {"crash": -11, "hang": 0, "good": DRIVEN}
    requests = [
        msgspec.structs.replace(REQUEST, robot=RobotCheck(f"{name}.urdf")) for name in outcomes
    ]
    seen: list[str] = []

    rows = run_checks(
        requests,
        lambda request: outcomes[Path(request.robot.path).stem],
        jobs=2,
        tolerance=0.05,
        on_row=lambda row: seen.append(row.verdict),
    )

    assert [row.verdict for row in rows] == seen == ["crashed", "timeout", "ok"]


def test_a_trial_process_is_ended_at_its_timeout() -> None:
    assert run_trial_process(REQUEST, 0.01) == 0
