"""What the checks of ROS 2 stacks read of a description and of this host."""

from pathlib import Path

import pytest

from zensim.deploy.cli.ros_observation import find_mesh_fault, read_description

URDF = """<robot name="r"><link name="a"><visual><geometry>
<mesh filename="package://p/a.stl"/></geometry></visual></link><link name="b"/></robot>"""
SDF = """<sdf version="1.7"><model name="m"><link name="a"><visual name="v"><geometry>
<mesh><uri>model://m/a.dae</uri></mesh></geometry></visual></link></model></sdf>"""


def test_links_and_meshes_of_both_formats_are_read() -> None:
    assert read_description(URDF) == (("a", "b"), ("package://p/a.stl",))
    assert read_description(SDF) == (("a",), ("model://m/a.dae",))


def test_text_that_is_no_description_has_no_links() -> None:
    assert read_description("<!DOCTYPE a [<!ENTITY x 'y'>]><robot/>") == ((), ())
    assert read_description("no xml") == ((), ())


def test_meshes_are_found_in_packages_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = tmp_path / "share" / "p"
    share.mkdir(parents=True)
    (share / "package.xml").write_text("<package><name>p</name></package>")
    (share / "a.stl").write_text("solid")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))

    assert find_mesh_fault("package://p/a.stl") == ""
    assert find_mesh_fault(f"file://{share}/a.stl") == ""
    assert find_mesh_fault("http://127.0.0.1:1/a.stl")
    assert find_mesh_fault("http://[/a.stl")
    assert find_mesh_fault("package://p/b.stl")
    assert find_mesh_fault(f"file://{share}/b.stl")
    assert find_mesh_fault("meshes/a.stl")
