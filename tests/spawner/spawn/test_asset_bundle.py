"""Bundles of files, and their upload."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.spawner.packages import make_package, robot_of, tetrahedron
from zensim.proto.messages.asset_messages import (
    MAX_BUNDLE_FILES,
    MAX_CHUNK_BYTES,
    MAX_FILE_BYTES,
    AssetRef,
    MissingAssetsResponse,
)
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn import asset_bundle
from zensim.spawner.spawn.asset_bundle import (
    AssetBundle,
    AssetFile,
    MeshReference,
    PendingFile,
    check_collision_meshes,
    find_meshes,
    find_pending_files,
    make_bundle,
    send_file,
)
from zensim.spawner.spawn.description_xml import parse_description
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

BASE, DRAWN = "package://my_robot/meshes/base.stl", "package://my_robot/meshes/drawn.stl"


def make_bundle_in(folder: Path, text: str) -> AssetBundle:
    return make_bundle(text, collect_search_paths([folder], {}))


def test_meshes_of_urdf_are_listed_once_with_their_use() -> None:
    text = robot_of(" base.stl ", "drawn.stl").replace(
        "</link>", '<visual><geometry><mesh filename="base.stl"/></geometry></visual></link>'
    )

    assert find_meshes(parse_description(text)) == (
        MeshReference("base.stl", is_collision=True),
        MeshReference("drawn.stl", is_collision=False),
    )


def test_meshes_of_sdf_are_listed() -> None:
    text = (
        "<sdf version='1.6'><model name='m'><link name='l'><collision name='c'><geometry>"
        "<mesh><uri>model://m/c.dae</uri></mesh></geometry></collision></link></model></sdf>"
    )

    assert [mesh.uri for mesh in find_meshes(parse_description(text))] == ["model://m/c.dae"]


def test_bundle_identifies_files_by_content(tmp_path: Path) -> None:
    make_package(tmp_path)
    digest = hashlib.sha256(tetrahedron()).hexdigest()

    bundle = make_bundle_in(tmp_path, robot_of(BASE, DRAWN))

    assert bundle.refs[0] == AssetRef(BASE, digest)
    assert [file.size for file in bundle.files] == [284, 284]
    assert bundle.missing == ()


def test_bundle_holds_equal_files_once(tmp_path: Path) -> None:
    package = make_package(tmp_path)
    (package / "meshes" / "drawn.stl").write_bytes(tetrahedron())

    bundle = make_bundle_in(tmp_path, robot_of(BASE, DRAWN))

    assert len(bundle.refs) == 2
    assert len(bundle.files) == 1


def test_missing_visual_is_accepted_and_missing_collision_refused(tmp_path: Path) -> None:
    make_package(tmp_path)
    without_visual = make_bundle_in(tmp_path, robot_of(BASE, "package://my_robot/nothing.stl"))
    without_collision = make_bundle_in(tmp_path, robot_of("package://my_robot/nothing.stl", DRAWN))

    check_collision_meshes(without_visual)
    with pytest.raises(ServiceError, match=r"^.*mesh.missing: .*nothing.stl") as caught:
        check_collision_meshes(without_collision)

    assert [file.mesh.uri for file in without_visual.missing] == ["package://my_robot/nothing.stl"]
    assert caught.value.code == SpawnCode.MISSING_ASSETS


@pytest.mark.parametrize("name", ["id_rsa", "passwd", "a.txt", "stl"])
def test_file_without_a_mesh_suffix_is_never_sent(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"secret")

    bundle = make_bundle_in(tmp_path, robot_of(name))

    assert bundle.files == ()
    assert len(bundle.missing) == 1


def test_bundle_with_a_large_file_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)

    with pytest.raises(ServiceError, match=r"bundle.size: .*large.stl"):
        make_bundle_in(tmp_path, robot_of("large.stl"))


def test_bundle_with_many_files_is_refused(tmp_path: Path) -> None:
    names = [f"{number}.stl" for number in range(MAX_BUNDLE_FILES + 1)]
    for name in names:
        (tmp_path / name).write_bytes(name.encode())
    parts = "".join(f'<visual><mesh filename="{name}"/></visual>' for name in names)

    with pytest.raises(ServiceError, match=r"bundle.files: .*513"):
        make_bundle_in(tmp_path, f"<robot>{parts}</robot>")


def test_large_bundle_is_refused(tmp_path: Path) -> None:
    for number in range(5):
        with (tmp_path / f"{number}.stl").open("wb") as file:
            file.truncate(MAX_FILE_BYTES - number)
    parts = "".join(f'<visual><mesh filename="{number}.stl"/></visual>' for number in range(5))

    with pytest.raises(ServiceError, match=r"bundle.size: .*320.0 MiB"):
        make_bundle_in(tmp_path, f"<robot>{parts}</robot>")


def test_bundle_has_images_of_meshes_and_of_the_description(tmp_path: Path) -> None:
    for name in ("meshes", "materials/textures"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "meshes" / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\n")
    (tmp_path / "meshes" / "a.mtl").write_text("newmtl m\nmap_Kd C:\\art\\wood.png\n")
    (tmp_path / "materials" / "textures" / "wood.png").write_bytes(b"wood")
    (tmp_path / "own.png").write_bytes(b"own")
    (tmp_path / "secret.txt").write_bytes(b"secret")
    texture = '<material name="m"><texture filename="own.png"/></material>'
    other = '<material name="n"><texture filename="secret.txt"/></material>'
    mesh = '<geometry><mesh filename="meshes/a.obj"/></geometry>'
    text = f'<robot name="r"><link name="l"><visual>{mesh}{texture}{other}</visual></link></robot>'

    bundle = make_bundle(text, SearchPaths(folder=tmp_path))

    assert {ref.uri for ref in bundle.refs} == {
        "meshes/a.obj", "meshes/a.mtl", "materials/textures/wood.png", "own.png",
    }  # fmt: skip


def test_texture_outside_the_search_paths_is_not_sent(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(b"private")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "a.dae").write_text(
        f"<init_from>../photo.png</init_from><init_from>{tmp_path}/photo.png</init_from>"
    )
    mesh = '<visual><geometry><mesh filename="a.dae"/></geometry></visual>'
    text = f'<robot name="r"><link name="l">{mesh}</link></robot>'

    bundle = make_bundle(text, SearchPaths(folder=tmp_path / "robot"))

    assert [ref.uri for ref in bundle.refs] == ["a.dae"]


def test_texture_without_room_is_left_out_with_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.dae").write_text("<init_from>a.png</init_from>")
    (tmp_path / "a.png").write_bytes(bytes(100))
    monkeypatch.setattr(asset_bundle, "MAX_BUNDLE_BYTES", 60)
    mesh = '<visual><geometry><mesh filename="a.dae"/></geometry></visual>'
    text = f'<robot name="r"><link name="l">{mesh}</link></robot>'

    bundle = make_bundle(text, SearchPaths(folder=tmp_path))

    assert [ref.uri for ref in bundle.refs] == ["a.dae"]
    assert [note.subject for note in bundle.notes] == ["texture 'a.png'"]


def test_bundle_has_included_models_and_their_meshes(tmp_path: Path) -> None:
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

    bundle = make_bundle_in(tmp_path, text.format("model://crate"))

    assert [ref.uri for ref in bundle.refs] == ["model://crate", "model://crate/box.stl"]
    assert make_bundle_in(tmp_path, text.format("model://nothing")) == AssetBundle()


def test_relative_meshes_belong_to_their_model(tmp_path: Path) -> None:
    for number, name in enumerate(("one", "two"), start=1):
        (tmp_path / name / "meshes").mkdir(parents=True)
        (tmp_path / name / "meshes" / "a.stl").write_bytes(tetrahedron(number))
        (tmp_path / name / "model.sdf").write_text(
            "<sdf version='1.6'><model name='m'><link name='l'><visual name='v'><geometry><mesh>"
            "<uri>meshes/a.stl</uri></mesh></geometry></visual></link></model></sdf>"
        )
    uris = ("model://one", "model://two/model.sdf")
    includes = "".join(f"<include><uri>{uri}</uri></include>" for uri in uris)

    bundle = make_bundle_in(
        tmp_path, f"<sdf version='1.6'><model name='m'>{includes}</model></sdf>"
    )

    digests = {ref.uri: ref.sha256 for ref in bundle.refs}
    assert digests["model://one/meshes/a.stl"] == hashlib.sha256(tetrahedron(1)).hexdigest()
    assert digests["model://two/meshes/a.stl"] == hashlib.sha256(tetrahedron(2)).hexdigest()


class UploadClient(SimClient):
    """Stores chunks like a server; times out `silences` times."""

    def __init__(self, *, silences: int = 0) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.held: dict[str, bytes] = {}
        self.totals: dict[str, int] = {}
        self.chunks: list[int] = []
        self._silences = silences

    def missing_assets(self, sha256s: tuple[str, ...]) -> MissingAssetsResponse:
        missing = tuple(
            sha for sha in sha256s if len(self.held.get(sha, b"")) != self.totals.get(sha, -1)
        )
        return MissingAssetsResponse(
            missing=missing, received=tuple(len(self.held.get(sha, b"")) for sha in missing)
        )

    def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
        self.totals[sha256] = total
        held = self.held.setdefault(sha256, b"")
        if offset == len(held):
            self.held[sha256] = held + data
            self.chunks.append(len(data))
        if self._silences:
            self._silences -= 1
            raise TimeoutError("no reply")
        return len(self.held[sha256])


def make_file(folder: Path, data: bytes) -> AssetFile:
    path = folder / "a.stl"
    path.write_bytes(data)
    return AssetFile(path, hashlib.sha256(data).hexdigest(), len(data))


DATA = bytes(range(256)) * 40_000


@pytest.mark.parametrize("silences", [0, 1, 2])
def test_upload_completes_despite_lost_replies(tmp_path: Path, silences: int) -> None:
    store, file = UploadClient(silences=silences), make_file(tmp_path, DATA)
    sent: list[int] = []

    send_file(store, find_pending_files(store, [file])[0], sent.append)

    assert store.held[file.sha256] == DATA
    assert max(store.chunks) == MAX_CHUNK_BYTES
    assert sum(sent) == len(DATA)


def test_upload_continues_a_partial_file(tmp_path: Path) -> None:
    store, file = UploadClient(), make_file(tmp_path, DATA)
    store.held[file.sha256] = DATA[:1_000_000]

    pending = find_pending_files(store, [file])
    send_file(store, pending[0], lambda _: None)

    assert pending == [PendingFile(file, 1_000_000)]
    assert store.held[file.sha256] == DATA
    assert sum(store.chunks) == len(DATA) - 1_000_000


def test_complete_file_is_not_sent(tmp_path: Path) -> None:
    store, file = UploadClient(), make_file(tmp_path, DATA)
    send_file(store, PendingFile(file, 0), lambda _: None)

    assert find_pending_files(store, [file]) == []


def test_empty_file_is_sent_once(tmp_path: Path) -> None:
    store, file = UploadClient(), make_file(tmp_path, b"")

    send_file(store, find_pending_files(store, [file])[0], lambda _: None)

    assert store.chunks == [0]


def test_upload_fails_without_progress(tmp_path: Path) -> None:
    class SilentClient(UploadClient):
        def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
            del sha256, offset, total, data
            raise TimeoutError("no reply")

    store, file = SilentClient(), make_file(tmp_path, DATA)

    with pytest.raises(TimeoutError, match="0 bytes"):
        send_file(store, PendingFile(file, 0), lambda _: None)


def test_no_call_is_made_without_files() -> None:
    assert find_pending_files(UploadClient(), []) == []
