"""`zensim model`: descriptions, meshes and xacro, without a server."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.spawner.packages import make_package, robot_of
from zensim.deploy.cli.model_commands import app
from zensim.proto.exit_codes import ExitCode

RUNNER = CliRunner()
BASE, GONE = "package://my_robot/meshes/base.stl", "package://my_robot/meshes/gone.stl"
XACRO = (
    '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    '<xacro:arg name="link" default="a"/><link name="$(arg link)"/></robot>'
)


def make_file(folder: Path, text: str, name: str = "r.urdf") -> str:
    file = make_package(folder) / "urdf" / name
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_model_prints_a_tree_of_links() -> None:
    done = RUNNER.invoke(app, ["box_bot"])

    assert done.exit_code == ExitCode.OK
    for name in ("base_link", "left_wheel", "right_wheel_joint"):
        assert name in done.stdout


def test_model_prints_json() -> None:
    facts = json.loads(RUNNER.invoke(app, ["box_bot", "--json"]).stdout)

    assert {"links", "joints", "mass_kg", "drive", "report"} <= set(facts)
    assert facts["name"] == "box_bot"
    assert facts["written"] == {"links": 9, "joints": 8}


def test_model_reads_meshes_of_the_package(tmp_path: Path) -> None:
    done = RUNNER.invoke(app, [make_file(tmp_path, robot_of(BASE)), "--json"])

    assert json.loads(done.stdout)["report"] == []


def test_model_reports_a_missing_visual_once(tmp_path: Path) -> None:
    done = RUNNER.invoke(app, [make_file(tmp_path, robot_of(BASE, GONE)), "--json"])

    report = json.loads(done.stdout)["report"]
    assert [entry["status"] for entry in report] == ["suspicious"]
    assert "gone.stl" in report[0]["reason"]


@pytest.mark.parametrize(
    ("text", "flags", "status", "code"),
    [
        (robot_of(GONE), (), ExitCode.FAILED, "mesh.missing: "),
        (robot_of(GONE), ("--allow-missing",), ExitCode.OK, ""),
        (robot_of(BASE, GONE), ("--strict",), ExitCode.FAILED, "report.suspicious: "),
        (robot_of(BASE), ("--strict",), ExitCode.OK, ""),
        (robot_of(BASE), ("--compat", "ignition"), ExitCode.USAGE, "--compat"),
        ("<robot", (), ExitCode.FAILED, "xml.syntax: "),
        ('<robot name="r"/>', (), ExitCode.FAILED, "urdf.no_links: "),
    ],
)
def test_model_refuses_like_a_server(
    tmp_path: Path, text: str, flags: tuple[str, ...], status: ExitCode, code: str
) -> None:
    done = RUNNER.invoke(app, [make_file(tmp_path, text), *flags])

    assert done.exit_code == status, done.stderr
    assert code in done.stderr
    assert done.stderr.count("\n") == bool(code)


def test_model_expands_xacro_with_arguments(tmp_path: Path) -> None:
    file = make_file(tmp_path, XACRO, "r.xacro")

    done = RUNNER.invoke(app, [file, "--xacro-arg", "link:=b", "--json"])

    assert [link["name"] for link in json.loads(done.stdout)["links"]] == ["b"]


def test_model_reads_sdf(tmp_path: Path) -> None:
    sdf = '<sdf version="1.6"><model name="m"><link name="l"/></model></sdf>'

    done = RUNNER.invoke(app, [make_file(tmp_path, sdf, "model.sdf"), "--json"])

    assert json.loads(done.stdout)["name"] == "m"


def test_model_refuses_a_binary_file(tmp_path: Path) -> None:
    file = tmp_path / "broken.urdf"
    file.write_bytes(b"\xff\xfe\x00")

    done = RUNNER.invoke(app, [str(file)])

    assert done.exit_code == ExitCode.USAGE
    assert done.stderr.startswith("zensim model: ")


def test_model_fails_for_a_missing_file() -> None:
    done = RUNNER.invoke(app, ["nowhere.urdf"])

    assert done.exit_code == ExitCode.NOT_FOUND
    assert done.stderr.startswith("zensim model: ")
    assert "nowhere.urdf" in done.stderr
