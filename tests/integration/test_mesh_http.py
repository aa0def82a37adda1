"""A server that offers meshes by http, so that RViz finds them without their package.

Its world lacks a model, which is its first warning on `/rosout`.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import pytest

from tests.integration.processes import Server, eventually, running_agents, serving, zensim
from tests.integration.ros_client_process import session_of
from tests.integration.ros_subscriptions import read_late_joining
from tests.spawner.packages import make_package
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import String
from zensim.proto.ros2.node_messages import RosoutLog
from zensim.sim_server.description.builtin_models import read_builtin_model

COVER = (
    '<link name="cover"><visual><geometry><mesh filename="package://my_robot/meshes/base.stl"/>'
    '</geometry></visual></link><joint name="lid" type="fixed"><parent link="base_link"/>'
    '<child link="cover"/></joint></robot>'
)
WORLD = (
    '<sdf version="1.7"><world name="w"><include><uri>model://no_such_model</uri></include>'
    "</world></sdf>"
)
WITHIN_S = 20.0


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_package(tmp_path_factory.mktemp("workspace"))


@pytest.fixture(scope="module")
def server(package: Path) -> Iterator[Server]:
    file = package / "urdf" / "covered.urdf"
    file.write_text(read_builtin_model("box_bot").replace("</robot>", COVER), encoding="utf-8")
    world = package / "world.sdf"
    world.write_text(WORLD, encoding="utf-8")
    options = ("--ros-domain", "0", "--mesh-http", "127.0.0.1:0")
    with serving(*options, "--world", str(world), "--allow-missing") as found:
        found.zensim("spawn", str(file), "--name", "r1")
        with running_agents(found, "r1"):
            yield found


def read_published_url(server: Server) -> str:
    """Read the URL of the mesh in the description that the agent publishes."""
    samples = eventually(
        lambda: server.bus.get("r1/robot_description") or None, WITHIN_S, "a robot description"
    )
    text = decode(String, samples[0].payload, samples[0].encoding).data
    assert "package://" not in text
    return text.partition('<mesh filename="')[2].partition('"')[0]


def test_published_description_names_meshes_by_url(server: Server, package: Path) -> None:
    url = read_published_url(server)

    with urlopen(url, timeout=5.0) as response:
        assert response.read() == (package / "meshes" / "base.stl").read_bytes()


def test_doctor_finds_the_meshes_that_are_served(server: Server) -> None:
    done = zensim("doctor", "--json", "--connect", server.endpoint, "--ros", "rviz", "r1")

    (row,) = [one for one in json.loads(done.stdout) if one["what"] == "meshes"]
    assert row["mark"] == "ok"


def test_warning_from_before_the_node_is_on_rosout(server: Server) -> None:
    with session_of(server) as session:
        samples = read_late_joining(session, "/rosout", 1)

    logs = [decode(RosoutLog, one.payload) for one in samples]
    assert any(one.name == "zensim" and "no_such_model" in one.msg for one in logs)
    assert all(one.file.startswith("zensim/sim_server/") for one in logs)


def test_other_hosts_are_admitted_by_decision_only() -> None:
    done = zensim("serve", "--listen", "tcp/127.0.0.1:0", "--mesh-http", "0.0.0.0:0")

    assert done.returncode == ExitCode.USAGE
    assert "--insecure" in done.stderr


@pytest.mark.parametrize("address", ["8090", "127.0.0.1:99999", "a b:1", "127.0.0.1:80/x"])
def test_address_that_is_not_valid_is_refused(address: str) -> None:
    done = zensim("serve", "--listen", "tcp/127.0.0.1:0", "--mesh-http", address)

    assert done.returncode == ExitCode.USAGE
    assert "--mesh-http" in done.stderr
