"""Options of `zensim spawn` on a real server."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.deploy.cli.commands import run_at
from tests.integration.processes import (
    END_S,
    Server,
    command_line,
    eventually,
    read_json_line,
    running,
    serving,
    without_libraries,
    zensim,
)
from tests.spawner.packages import make_package, robot_of
from zensim.deploy.cli.spawn_commands import app
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.messages.standard_messages import String
from zensim.spawner.spawn.spawn_client import read_payload

BOX = (
    '<robot name="box"><link name="base"><inertial><mass value="2"/>'
    '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link></robot>'
)
SMALL_XACRO = BOX.replace(
    '<robot name="box">',
    '<robot name="box" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    '<xacro:property name="mass" value="2"/>',
).replace('value="2"/><inertia', 'value="${mass}"/><inertia')
BASE, DRAWN = "package://my_robot/meshes/base.stl", "package://my_robot/meshes/drawn.stl"
XACRO = (
    '<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    '<xacro:arg name="mass" default="1"/><xacro:include filename="part.xacro"/>'
    '<xacro:part name="base" mass="$(arg mass)"/></robot>'
)
PART = (
    '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="part" '
    'params="name mass"><link name="${name}"><inertial><mass value="${mass}"/>'
    '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial><collision>'
    '<geometry><box size="${0.1 * 2} 0.2 0.2"/></geometry></collision></link></xacro:macro></robot>'
)


@pytest.fixture(scope="module")
def running_server() -> Iterator[Server]:
    with serving() as found:
        yield found


@pytest.fixture
def server(running_server: Server) -> Server:
    running_server.client.reset(ResetScope.ALL)
    return running_server


@pytest.fixture
def box(tmp_path: Path) -> Path:
    file = tmp_path / "box.urdf"
    file.write_text(BOX)
    return file


def spawned(server: Server, *arguments: str) -> str:
    done = run_at(server, app, "spawn", *arguments)
    assert done.status == ExitCode.OK, done.err
    return done.out


def refused(server: Server, *arguments: str) -> str:
    done = run_at(server, app, "spawn", *arguments)
    assert done.status != ExitCode.OK, done.out
    assert done.out == ""
    assert done.err.count("\n") == 1
    return done.err


def mass_of(server: Server, name: str) -> float:
    return server.client.models((name,)).models[0].mass_kg


def test_spawn_prints_the_result_for_each_plug_in(server: Server) -> None:
    lines = spawned(server, "box_bot", "--name", "r1").splitlines()

    assert lines[0] == "spawned r1 under r1/"
    assert any(line.startswith("applied") and "separation 0.11 m" in line for line in lines)


def test_dry_run_prints_its_plan_without_effect(server: Server) -> None:
    would = spawned(server, "box_bot", "--name", "r1", "--dry-run")

    assert would.startswith("would spawn r1 under r1/\n")
    assert server.client.entities() == ()


def test_dry_run_fails_like_the_spawn(server: Server) -> None:
    spawned(server, "box_bot", "--name", "r1")

    assert "name.taken" in refused(server, "box_bot", "--name", "r1", "--dry-run")


def test_strict_refuses_warnings(server: Server) -> None:
    assert "report.suspicious" in refused(server, "box_bot", "-z", "0", "--strict")
    assert "below ground" in spawned(server, "box_bot", "-z", "0")


def test_snap_to_ground_overrides_a_height(server: Server) -> None:
    spawned(server, "box_bot", "--name", "r1", "-z", "3", "--snap-to-ground")

    assert server.client.entity_state("r1").pose.position.z == pytest.approx(0.06, abs=0.01)


def test_gazebo_spelling_does_the_same(server: Server, box: Path) -> None:
    place = ("-x", "1", "-y", "2", "-z", "0.1", "-R", "0", "-P", "0", "-Y", "1")
    options = ("-robot_namespace", "team/a", "-reference_frame", "map", "-timeout", "5")

    spawned(server, "-entity", "e1", "-file", str(box), *place, *options)

    model = server.client.entity_model("e1")
    assert model.namespace == "team/a"
    assert (model.initial_pose.position.x, model.initial_pose.position.y) == (1.0, 2.0)


def test_database_names_a_shipped_model(server: Server) -> None:
    spawned(server, "-database", "box_bot", "-entity", "d1")

    assert server.client.entities() == ("d1",)


@pytest.mark.parametrize(("source", "text"), [("-stdin", BOX), ("-", SMALL_XACRO)])
def test_description_is_read_from_standard_input(server: Server, source: str, text: str) -> None:
    done = subprocess.run(
        command_line(["spawn", source, "-entity", "s1", "--connect", server.endpoint]),
        input=text,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    assert mass_of(server, "s1") == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("payload", "encoding"),
    [
        (encode(String(BOX), Format.CDR), make_encoding(String, Format.CDR)),
        (json.dumps({"data": BOX}).encode(), "application/json"),
        (BOX.encode(), ""),
    ],
    ids=["cdr", "json", "text"],
)
def test_description_is_read_from_a_queryable(
    server: Server, payload: bytes, encoding: str
) -> None:
    queue = server.bus.serve("lab/robot_description")
    with running(
        "spawn", "-topic", "lab/robot_description", "-entity", "t1", "--connect", server.endpoint
    ) as process:
        calls = eventually(lambda: queue.take() or None, 20.0, "asking for the description")
        calls[0].reply(payload, encoding)
        process.wait(END_S)
    queue.close()

    assert mass_of(server, "t1") == pytest.approx(2.0)


def test_description_is_read_from_a_publication(server: Server) -> None:
    with running(
        "spawn", "-topic", "/lab/description", "-entity", "t1", "--connect", server.endpoint
    ) as process:
        publisher = server.bus.advertise("lab/description", "")

        def put() -> bool:
            publisher.send(BOX.encode())
            return process.poll() is not None

        eventually(put, 20.0, "spawning")
    assert mass_of(server, "t1") == pytest.approx(2.0)


def test_waiting_for_a_topic_or_an_entity_times_out(server: Server) -> None:
    for option in (("-topic", "nothing/there"), ("box_bot", "-wait", "nobody")):
        assert "zensim spawn: " in refused(server, *option, "-timeout", "0.3")


def test_spawn_waits_for_another_entity(server: Server) -> None:
    arguments = ("spawn", "box_bot", "-entity", "r2", "-wait", "r1", "--connect", server.endpoint)
    with running(*arguments) as process:
        spawned(server, "box_bot", "-entity", "r1", "-y", "1")
        process.wait(END_S)

    assert server.client.entities() == ("r1", "r2")


def test_unpause_plays_the_world(server: Server) -> None:
    server.client.set_simulation_state(State.PAUSED)

    spawned(server, "box_bot", "-unpause")
    spawned(server, "box_bot", "-unpause", "-y", "1")

    assert server.client.simulation_state() == State.PLAYING


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (("box_bot", "-J", "a", "1"), "-J"),
        (("box_bot", "-database", "box_bot"), "MODEL and -database"),
        (("-file", "nowhere.urdf"), "nowhere.urdf"),
        (("-database", "nothing"), "nothing"),
        (("-topic", "a b"), "'a b'"),
        (("box_bot", "--compat", "ignition"), "'ignition'"),
        (("box_bot", "-timeout", "-1"), "-1"),
        (("box_bot", "--package-path", "/nowhere"), "/nowhere"),
    ],
    ids=str,
)
def test_invalid_option_is_refused_in_one_line(
    server: Server, arguments: tuple[str, ...], value: str
) -> None:
    assert value in refused(server, *arguments)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_bonded_entity_is_deleted_with_its_command(server: Server, number: signal.Signals) -> None:
    arguments = ("spawn", "box_bot", "-entity", "b1", "-b", "--json", "--connect", server.endpoint)
    with running(*arguments) as process:
        assert read_json_line(process)["entity_name"] == "b1"
        assert len(server.bus.list_tokens(keys.bonds("default"))) == 1
        os.kill(process.pid, number)

        eventually(lambda: server.client.entities() == (), 10.0, "going")


def test_bond_ends_when_the_entity_was_deleted(server: Server) -> None:
    arguments = ("spawn", "box_bot", "-entity", "b1", "--bond", "--json")
    with running(*arguments, "--connect", server.endpoint) as process:
        read_json_line(process)

        server.client.delete("b1")

        assert process.wait(END_S) == 0


def test_meshes_are_sent_once(server: Server, tmp_path: Path) -> None:
    file = make_package(tmp_path) / "urdf" / "r.urdf"
    file.write_text(robot_of(BASE, DRAWN, name="first"))

    spawned(server, str(file), "--name", "m1")
    file.write_text(robot_of(BASE, DRAWN, name="second"))
    done = run_at(server, app, "fleet", str(file), "--robots", "2", "--prefix", "m2", "--json")

    assert done.status == ExitCode.OK, done.out
    shapes = server.client.models(("m1",)).models[0].links[0].collisions
    assert [shape.kind for shape in shapes] == ["mesh"]


def test_second_spawn_sends_no_meshes(server: Server, tmp_path: Path) -> None:
    file = make_package(tmp_path) / "urdf" / "r.urdf"
    file.write_text(robot_of(BASE, DRAWN))
    digests = tuple(ref.sha256 for ref in read_payload(str(file)).bundle.refs)

    spawned(server, str(file), "--name", "m1")

    assert len(digests) == 2
    assert server.client.missing_assets(digests).missing == ()


def test_sdf_is_spawned_with_the_models_that_it_includes(server: Server, tmp_path: Path) -> None:
    crate = make_package(tmp_path, "crate")
    (crate / "model.sdf").write_text(
        "<sdf version='1.6'><model name='crate'><link name='box'><inertial><mass>3</mass>"
        "</inertial><collision name='c'><geometry><mesh><uri>model://crate/meshes/base.stl</uri>"
        "</mesh></geometry></collision></link></model></sdf>"
    )
    file = tmp_path / "two.sdf"
    file.write_text(
        "<sdf version='1.6'><model name='two'><link name='base'><inertial><mass>1</mass></inertial>"
        "</link><include><uri>model://crate</uri></include><joint name='j' type='fixed'>"
        "<parent>base</parent><child>crate::box</child></joint></model></sdf>"
    )

    spawned(server, str(file), "--name", "s1", "--package-path", str(tmp_path))

    assert mass_of(server, "s1") == pytest.approx(4.0)


def test_missing_visual_gives_one_warning(server: Server, tmp_path: Path) -> None:
    file = make_package(tmp_path) / "urdf" / "r.urdf"
    file.write_text(robot_of(BASE, "package://my_robot/meshes/gone.stl"))

    report = json.loads(spawned(server, str(file), "--json"))["report"]

    assert len([one for one in report if "gone.stl" in one["subject"] + one["reason"]]) == 1


def test_missing_collision_is_refused_unless_allowed(server: Server, tmp_path: Path) -> None:
    file = make_package(tmp_path) / "urdf" / "r.urdf"
    file.write_text(robot_of("package://my_robot/meshes/gone.stl", DRAWN))

    assert "mesh.missing: " in refused(server, str(file))
    spawned(server, str(file), "--name", "m1", "--allow-missing")
    assert server.client.entities() == ("m1",)


def test_package_to_model_finds_meshes(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(robot_of(BASE))
    make_package(tmp_path / "models")

    spawned(server, str(file), "-package_to_model", "--package-path", str(tmp_path / "models"))


def test_xacro_is_expanded_with_its_arguments(server: Server, tmp_path: Path) -> None:
    (tmp_path / "r.urdf.xacro").write_text(XACRO)
    (tmp_path / "part.xacro").write_text(PART)

    spawned(server, str(tmp_path / "r.urdf.xacro"), "--name", "x1", "--xacro-arg", "mass:=3.5")

    assert mass_of(server, "x1") == pytest.approx(3.5)


def test_xacro_that_cannot_be_expanded_is_refused_in_one_line(
    server: Server, tmp_path: Path
) -> None:
    (tmp_path / "r.xacro").write_text(XACRO)

    assert "r.xacro" in refused(server, str(tmp_path / "r.xacro"))
    assert "'a=1'" in refused(server, str(tmp_path / "r.xacro"), "--xacro-arg", "a=1")


def test_xacro_names_the_extra_when_it_is_not_installed(tmp_path: Path) -> None:
    (tmp_path / "r.xacro").write_text(XACRO)

    done = zensim(
        "spawn", str(tmp_path / "r.xacro"), prefix=without_libraries(tmp_path, "xacrodoc")
    )

    assert done.returncode != 0
    assert "pip install 'zensim[xacro]'" in done.stderr
    assert done.stderr.count("\n") == 1
