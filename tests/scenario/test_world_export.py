"""A running world becomes a scenario file that starts an equal world."""

from pathlib import Path

import numpy as np
import pytest

import zensim
from zensim.scenario.model_dry_run import check_models
from zensim.scenario.scenario_reader import read_scenario
from zensim.scenario.scenario_runner import ScenarioFailed
from zensim.scenario.world_export import export_world

CRATE = (
    '<robot name="crate"><link name="box"><inertial><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><geometry><box size="0.4 0.4 0.4"/></geometry></collision></link></robot>'
)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_exported_world_starts_in_the_same_state(engine: str, tmp_path: Path) -> None:
    (tmp_path / "crate.urdf").write_text(CRATE)
    file = tmp_path / "out.scenario.yaml"
    with zensim.World("walls", engine=engine, seed=7, step_hz=480, control_hz=60) as world:
        world.spawn_fleet("box_bot", poses=[(0, 0, 0), (1, 0, 0.5), (2, 0, -2.0)], prefix="bot")
        world.spawn(tmp_path / "crate.urdf", "crate_3", x=-1.0, y=1.0, yaw=0.3)
        world.spawn("box_bot", "other", x=-2.0, namespace="group/other")
        world.fleet(["bot0", "bot1", "bot2"]).drive(v=0.3, w=0.2)
        world.run_for(2.0)
        world.fleet(["bot0", "bot1", "bot2"]).stop()
        world.run_for(1.0)
        names = ["bot0", "bot1", "bot2", "crate_3", "other"]
        before = world.fleet(names).poses().copy()
        export_world(world, "out").write(file)
        periods = world.step_period, world.control_period

    with zensim.load(file) as run:
        after = run.fleet.poses()
        again = run.sim

        assert run.scenario.robot_names == names
        assert np.abs(after - before).max() < 1e-9
        assert (again.step_period, again.control_period) == periods
        assert (again.info.engine, again.seed, again.info.world_model) == (engine, 7, "walls")
        assert again.robots["other"].namespace == "group/other"


def test_empty_world_is_exported(tmp_path: Path) -> None:
    file = tmp_path / "out.scenario.yaml"
    with zensim.World() as world:
        export_world(world, "out").write(file)

    assert read_scenario(str(file)).robots == ()


def test_loaded_scenario_runs_to_its_end(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(
        "zensim: 1\nrobots: [{name: r, model: box_bot, tags: [fast]}]\n"
        "behaviours: [{name: go, robots: r, do: drive, v: 0.3}]\n"
        "checks: [{name: there, that: reached, point: [0.3, 0], by: 2}]\nend: {at: 2}\n"
    )

    with zensim.load(file, ["behaviours.go.v=0.4"]) as run:
        report = run.run()

        assert report.is_passed
        assert run.fleet.poses2d()[0, 0] > 0.7


def test_load_uses_a_world_that_runs(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text("zensim: 1\nrobots: [{name: r, model: box_bot}]\n")

    with zensim.World("walls") as world:
        with zensim.load(file, sim=world) as run:
            assert run.sim is world
        assert "r" in world.robots


FAULTS = (
    "faults:\n"
    "  - {name: jam, at: 1, robots: a, do: wheel_jam, joint: left_wheel_join}\n"
    "  - {name: shove, at: 1, robots: a, do: push, x: 1, link: roof}\n"
)


def test_dry_run_finds_what_a_server_would_refuse(tmp_path: Path) -> None:
    (tmp_path / "broken.urdf").write_text("<robot name='r'><link/></robot>")
    (tmp_path / "bad.sdf").write_text("<sdf version='1.7'><world/></sdf>")
    file = tmp_path / "a.scenario.yaml"
    file.write_text(
        "zensim: 1\nworld: {load: bad.sdf}\nrobots:\n  - {name: a, model: box_bot}\n"
        f"  - {{name: b, model: broken.urdf, poses: [{{x: 3}}]}}\n{FAULTS}"
    )

    issues = check_models(read_scenario(str(file)))

    found = [(one.path, one.place.line) for one in issues]
    assert found == [
        ("world.load", 2),
        ("robots[1].model", 5),
        ("faults[0].joint", 7),
        ("faults[1].link", 8),
    ]


def test_dry_run_searches_the_package_folders_of_a_group(tmp_path: Path) -> None:
    package = tmp_path / "vendor" / "parts"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>parts</name></package>")
    (package / "arm.xacro").write_text('<robot><link name="arm"/></robot>')
    (tmp_path / "r.urdf.xacro").write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find parts)/arm.xacro"/></robot>'
    )
    file = tmp_path / "a.scenario.yaml"
    text = "zensim: 1\nrobots:\n  - {{name: a, model: r.urdf.xacro{}}}\n"

    file.write_text(text.format(""))
    without = check_models(read_scenario(str(file)))
    file.write_text(text.format(", package_paths: [vendor]"))

    assert [one.path for one in without] == ["robots[0].model"]
    assert check_models(read_scenario(str(file))) == ()


def test_export_writes_no_file_over_another_unless_told_so(tmp_path: Path) -> None:
    (tmp_path / "crate.urdf").write_text(CRATE)
    file = tmp_path / "out.scenario.yaml"
    with zensim.World() as world:
        world.spawn(tmp_path / "crate.urdf", "crate")
        written = zensim.export(world, file)
        with pytest.raises(zensim.Invalid) as refused:
            zensim.export(world, file)
        again = zensim.export(world, file, overwrite=True)
        with pytest.raises(zensim.Invalid):
            zensim.export(world, tmp_path / "out.yaml")

    assert refused.value.slug == "file_exists"
    assert written == again == (file, tmp_path / "out.model0.urdf")


MODEL = "<sdf version='1.7'><model name='box'><static>true</static><link name='l'/></model></sdf>"
MODEL_CONFIG = "<model><sdf version='1.7'>model.sdf</sdf></model>"
INCLUDES = (
    "<sdf version='1.7'><world name='w'><include><uri>model://box</uri></include>{}</world></sdf>"
)


def test_scenario_in_process_finds_the_models_of_its_world(tmp_path: Path) -> None:
    (tmp_path / "models" / "box").mkdir(parents=True)
    (tmp_path / "models" / "box" / "model.sdf").write_text(MODEL)
    (tmp_path / "models" / "box" / "model.config").write_text(MODEL_CONFIG)
    (tmp_path / "here.sdf").write_text(INCLUDES.format(""))
    file = tmp_path / "a.scenario.yaml"
    file.write_text("zensim: 1\nworld: {load: here.sdf, model_paths: [models]}\n")

    with zensim.load(file) as run:
        assert "box" in run.sim.entities


def test_scenario_in_process_reads_its_world_as_strictly_as_it_says(tmp_path: Path) -> None:
    missing = "<include><uri>model://nowhere</uri></include>"
    (tmp_path / "here.sdf").write_text(INCLUDES.format(missing).replace("model://box", "model://b"))
    file = tmp_path / "a.scenario.yaml"
    file.write_text("zensim: 1\nworld: {load: here.sdf}\n")

    with pytest.raises(zensim.Invalid):
        zensim.load(file)
    with zensim.load(file, ["world.allow_missing=true"]) as run:
        assert not run.sim.entities
    with pytest.raises(zensim.Invalid):
        zensim.load(file, ["world.allow_missing=true", "world.strict=true"])


def test_scenario_in_process_refuses_workers_and_takes_clusters(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text("zensim: 1\nrobots: [{name: r, model: box_bot, count: 2}]\n")

    with pytest.raises(ScenarioFailed):
        zensim.load(file, ["engine.workers=2"])
    with zensim.load(file, ["engine.workers=0", "engine.clusters=on"]) as run:
        run.sim.run_for(0.1)
        assert run.fleet.alive.all()
