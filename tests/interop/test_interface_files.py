"""Interface files have the definitions of ROS, and rosbags computes zensim's hashes from them."""

from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.interop.interface_files import BUNDLED, write_interface_files
from zensim.proto.messages.gazebo_messages import ContactsState
from zensim.proto.messages.spawn_messages import SpawnEntity
from zensim.proto.messages.standard_messages import Altimeter
from zensim.proto.ros2.ros_service_catalog import ROS_SERVICES
from zensim.proto.ros2.type_hash import hash_type


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interfaces")
    write_interface_files(folder)
    return folder


def test_rosbags_computes_the_same_hashes_from_the_files(files: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for path in (files / "newest").glob("*/msg/*.msg"):
        name = f"{path.parts[-3]}/msg/{path.stem}"
        store.fielddefs.update(get_types_from_msg(path.read_text(), name))

    for message in (ContactsState, SpawnEntity, Altimeter):
        assert store.hash_rihs01(message.ros_type) == hash_type(message)


def test_each_service_has_a_file_in_its_version(files: Path) -> None:
    for service in ROS_SERVICES:
        package, _, name = service.ros_type.split("/")
        found = [*files.glob(f"*/{package}/srv/{name}.srv")]
        assert found or package in BUNDLED
    v1 = files / "v1" / "simulation_interfaces" / "srv" / "SpawnEntity.srv"
    assert "string uri\n" in v1.read_text()
    assert v1.read_text().count("---\n") == 1


def test_action_has_goal_result_and_feedback(files: Path) -> None:
    folder = files / "newest" / "simulation_interfaces" / "action"

    (action,) = folder.iterdir()

    assert action.read_text().split("---\n") == [
        "uint64 steps\n",
        "simulation_interfaces/Result result\n",
        "uint64 completed_steps\nuint64 remaining_steps\n",
    ]


def test_packages_of_hiroz_and_of_zensim_are_not_written(files: Path) -> None:
    written = {path.name for path in (files / "newest").iterdir()}

    assert written & {*BUNDLED, "zensim"} == set()
    assert (files / "bundled.txt").read_text().split() == [*BUNDLED]
