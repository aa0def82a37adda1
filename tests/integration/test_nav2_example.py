"""The files of the example for Nav2: scenario, parameters, and the launch file with stand-ins."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml

from tests.integration.processes import zensim

FOLDER = Path(__file__).parents[2] / "examples" / "nav2"
SCENARIO = FOLDER / "ten_robots.scenario.yaml"
ARGUMENTS = {"robots": "10", "prefix": "robot"}


class StandIn(SimpleNamespace):
    """Any class of launch: keeps its arguments."""

    def __init__(self, *arguments: object, **named: object) -> None:
        super().__init__(arguments=arguments, **named)

    def perform(self, _: object) -> str:
        """Read an argument of the launch."""
        return ARGUMENTS[str(self.arguments[0])]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    for name in ("launch", "launch.actions", "launch.substitutions", "launch_ros.actions"):
        module: Any = ModuleType(name)
        for kind in (
            "LaunchDescription",
            "DeclareLaunchArgument",
            "OpaqueFunction",
            "LaunchConfiguration",
            "Node",
        ):
            setattr(module, kind, StandIn)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "launch_ros", ModuleType("launch_ros"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return runpy.run_path(str(FOLDER / "robots.launch.py"))


def test_scenario_is_valid_and_has_ten_robots() -> None:
    done = zensim("scenario", "check", str(SCENARIO))

    assert done.returncode == 0, done.stdout + done.stderr
    (group,) = yaml.safe_load(SCENARIO.read_text())["robots"]
    assert len(group["poses"]) == int(ARGUMENTS["robots"])


@pytest.mark.parametrize("distribution", ["humble", "jazzy"])
def test_each_robot_has_its_nodes_and_parameters(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch, distribution: str
) -> None:
    monkeypatch.setenv("ROS_DISTRO", distribution)

    nodes = launch_file["make_robots"](None)

    managers = 1 if distribution == "humble" else 2
    assert len(nodes) == 10 * (6 + managers)
    assert {one.namespace for one in nodes} == {f"robot{number}" for number in range(10)}
    slam = next(one for one in nodes if one.name == "slam_toolbox")
    assert ("/tf", "tf") in slam.remappings
    parameters = yaml.safe_load(Path(slam.parameters[0]).read_text())
    assert parameters["/**/slam_toolbox"]["ros__parameters"]["scan_topic"] == "/robot0/scan"
    plugin = parameters["/**/planner_server"]["ros__parameters"]["GridBased"]["plugin"]
    assert plugin == f"nav2_navfn_planner{'/' if distribution == 'humble' else '::'}NavfnPlanner"


def test_parameters_cover_each_node_that_is_started(launch_file: dict[str, Any]) -> None:
    parameters = yaml.safe_load((FOLDER / "params.yaml").read_text())

    names = {f"/**/{name}" for name in (*launch_file["NODES"], "slam_toolbox")}

    costmaps = {"/**/local_costmap", "/**/global_costmap"}
    assert parameters.keys() == names | costmaps | {"/**"}
    assert {len(one) for one in parameters.values()} == {1}
