"""Assets: which files go with a description, and which descriptions are refused for them."""

import hashlib
from pathlib import Path

import pytest

from tests.spawner.packages import a_package, robot_of, tetrahedron
from zensim.proto.messages.asset_messages import MAX_BUNDLE_FILES, MAX_FILE_BYTES, AssetRef
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.spawner.assets import Bundle, Mesh, bundle_of, check_collisions, meshes_named
from zensim.spawner.search_paths import search_paths

BASE, DRAWN = "package://my_robot/meshes/base.stl", "package://my_robot/meshes/drawn.stl"


def bundle_in(folder: Path, text: str) -> Bundle:
    return bundle_of(text, search_paths([folder], {}))


def test_meshes_of_urdf_are_named_once_and_collisions_known() -> None:
    text = robot_of(" base.stl ", "drawn.stl").replace(
        "</link>", '<visual><geometry><mesh filename="base.stl"/></geometry></visual></link>'
    )

    assert meshes_named(text) == (Mesh("base.stl", True), Mesh("drawn.stl", False))  # noqa: FBT003


def test_meshes_of_sdf_are_named() -> None:
    text = (
        "<sdf version='1.6'><model name='m'><link name='l'><collision name='c'><geometry>"
        "<mesh><uri>model://m/c.dae</uri></mesh></geometry></collision></link></model></sdf>"
    )

    assert [mesh.uri for mesh in meshes_named(text)] == ["model://m/c.dae"]


def test_bundle_names_files_by_content(tmp_path: Path) -> None:
    a_package(tmp_path)
    digest = hashlib.sha256(tetrahedron()).hexdigest()

    bundle = bundle_in(tmp_path, robot_of(BASE, DRAWN))

    assert bundle.refs[0] == AssetRef(BASE, digest)
    assert [file.size for file in bundle.files] == [284, 284]
    assert bundle.missing == ()


def test_bundle_holds_equal_files_once(tmp_path: Path) -> None:
    package = a_package(tmp_path)
    (package / "meshes" / "drawn.stl").write_bytes(tetrahedron())

    bundle = bundle_in(tmp_path, robot_of(BASE, DRAWN))

    assert len(bundle.refs) == 2
    assert len(bundle.files) == 1


def test_missing_visual_is_noted_and_missing_collision_refused(tmp_path: Path) -> None:
    a_package(tmp_path)
    without_visual = bundle_in(tmp_path, robot_of(BASE, "package://my_robot/nothing.stl"))
    without_collision = bundle_in(tmp_path, robot_of("package://my_robot/nothing.stl", DRAWN))

    check_collisions(without_visual)
    with pytest.raises(ServiceError, match=r"mesh.missing.*nothing.stl.*--allow-missing") as caught:
        check_collisions(without_collision)

    assert [file.mesh.uri for file in without_visual.missing] == ["package://my_robot/nothing.stl"]
    assert caught.value.code == SpawnCode.MISSING_ASSETS


@pytest.mark.parametrize("name", ["id_rsa", "passwd", "a.txt", "stl"])
def test_file_that_is_no_mesh_is_never_sent(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"secret")

    bundle = bundle_in(tmp_path, robot_of(name))

    assert bundle.files == ()
    assert len(bundle.missing) == 1


def test_bundle_is_refused_when_a_file_is_too_large(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)

    with pytest.raises(ServiceError, match=r"bundle.size: .*large.stl has 64.0 MiB"):
        bundle_in(tmp_path, robot_of("large.stl"))


def test_bundle_is_refused_when_there_are_too_many_files(tmp_path: Path) -> None:
    names = [f"{number}.stl" for number in range(MAX_BUNDLE_FILES + 1)]
    for name in names:
        (tmp_path / name).write_bytes(name.encode())
    parts = "".join(f'<visual><mesh filename="{name}"/></visual>' for name in names)

    with pytest.raises(ServiceError, match=r"bundle.files: the description names 513 files"):
        bundle_in(tmp_path, f"<robot>{parts}</robot>")


def test_bundle_is_refused_when_it_is_too_large(tmp_path: Path) -> None:
    for number in range(5):
        with (tmp_path / f"{number}.stl").open("wb") as file:
            file.truncate(MAX_FILE_BYTES - number)
    parts = "".join(f'<visual><mesh filename="{number}.stl"/></visual>' for number in range(5))

    with pytest.raises(ServiceError, match=r"bundle.size: .* 320.0 MiB in all; at most 256 MiB"):
        bundle_in(tmp_path, f"<robot>{parts}</robot>")


def test_materials_of_a_mesh_are_reported_as_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\n")

    bundle = bundle_in(tmp_path, robot_of("a.obj", "a.obj").replace("collision", "visual"))

    assert [(note.status, note.subject) for note in bundle.notes] == [("ignored", "a.obj")]


def test_included_models_go_along_with_their_meshes(tmp_path: Path) -> None:
    model = tmp_path / "crate"
    model.mkdir()
    (model / "model.config").write_text("<model><sdf version='1.6'>crate.sdf</sdf></model>")
    (model / "box.stl").write_bytes(tetrahedron())
    (model / "crate.sdf").write_text(
        "<sdf version='1.6'><model name='crate'><link name='l'><visual name='v'><geometry><mesh>"
        "<uri>box.stl</uri></mesh></geometry></visual></link>"
        "<include><uri>model://crate</uri></include></model></sdf>"
    )
    text = "<sdf version='1.6'><model name='m'><include><uri>{0}</uri></include></model></sdf>"

    bundle = bundle_in(tmp_path, text.format("model://crate"))

    assert [ref.uri for ref in bundle.refs] == ["model://crate", "model://crate/box.stl"]
    assert bundle_in(tmp_path, text.format("model://nothing")) == Bundle()


def test_relative_meshes_of_two_models_are_each_their_own(tmp_path: Path) -> None:
    for number, name in enumerate(("one", "two"), start=1):
        (tmp_path / name / "meshes").mkdir(parents=True)
        (tmp_path / name / "meshes" / "a.stl").write_bytes(tetrahedron(number))
        (tmp_path / name / "model.sdf").write_text(
            "<sdf version='1.6'><model name='m'><link name='l'><visual name='v'><geometry><mesh>"
            "<uri>meshes/a.stl</uri></mesh></geometry></visual></link></model></sdf>"
        )
    uris = ("model://one", "model://two/model.sdf")
    includes = "".join(f"<include><uri>{uri}</uri></include>" for uri in uris)

    bundle = bundle_in(tmp_path, f"<sdf version='1.6'><model name='m'>{includes}</model></sdf>")

    digests = {ref.uri: ref.sha256 for ref in bundle.refs}
    assert digests["model://one/meshes/a.stl"] == hashlib.sha256(tetrahedron(1)).hexdigest()
    assert digests["model://two/meshes/a.stl"] == hashlib.sha256(tetrahedron(2)).hexdigest()
