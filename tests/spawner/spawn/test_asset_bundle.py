"""Upload: nothing twice, nothing from the start that is half there."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.spawner.packages import a_package, robot_of, tetrahedron
from zensim.proto.messages.asset_messages import (
    MAX_BUNDLE_FILES,
    MAX_CHUNK_BYTES,
    MAX_FILE_BYTES,
    AssetRef,
    MissingAssetsResponse,
)
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.asset_bundle import (
    AssetBundle,
    AssetFile,
    MeshReference,
    PendingFile,
    check_collision_meshes,
    find_pending_files,
    list_meshes,
    make_bundle,
    send_file,
)
from zensim.spawner.spawn.search_paths import collect_search_paths

if TYPE_CHECKING:
    from zensim.proto.bus import Bus

BASE, DRAWN = "package://my_robot/meshes/base.stl", "package://my_robot/meshes/drawn.stl"


def bundle_in(folder: Path, text: str) -> AssetBundle:
    return make_bundle(text, collect_search_paths([folder], {}))


def test_meshes_of_urdf_are_named_once_and_collisions_known() -> None:
    text = robot_of(" base.stl ", "drawn.stl").replace(
        "</link>", '<visual><geometry><mesh filename="base.stl"/></geometry></visual></link>'
    )

    assert list_meshes(text) == (MeshReference("base.stl", True), MeshReference("drawn.stl", False))  # noqa: FBT003


def test_meshes_of_sdf_are_named() -> None:
    text = (
        "<sdf version='1.6'><model name='m'><link name='l'><collision name='c'><geometry>"
        "<mesh><uri>model://m/c.dae</uri></mesh></geometry></collision></link></model></sdf>"
    )

    assert [mesh.uri for mesh in list_meshes(text)] == ["model://m/c.dae"]


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

    check_collision_meshes(without_visual)
    with pytest.raises(ServiceError, match=r"mesh\.missing.*nothing\.stl") as caught:
        check_collision_meshes(without_collision)

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

    with pytest.raises(ServiceError, match=r"bundle\.size: .*large\.stl"):
        bundle_in(tmp_path, robot_of("large.stl"))


def test_bundle_is_refused_when_there_are_too_many_files(tmp_path: Path) -> None:
    names = [f"{number}.stl" for number in range(MAX_BUNDLE_FILES + 1)]
    for name in names:
        (tmp_path / name).write_bytes(name.encode())
    parts = "".join(f'<visual><mesh filename="{name}"/></visual>' for name in names)

    with pytest.raises(ServiceError, match=r"bundle\.files: .*513"):
        bundle_in(tmp_path, f"<robot>{parts}</robot>")


def test_bundle_is_refused_when_it_is_too_large(tmp_path: Path) -> None:
    for number in range(5):
        with (tmp_path / f"{number}.stl").open("wb") as file:
            file.truncate(MAX_FILE_BYTES - number)
    parts = "".join(f'<visual><mesh filename="{number}.stl"/></visual>' for number in range(5))

    with pytest.raises(ServiceError, match=r"bundle\.size: .*320\.0 MiB.*256 MiB"):
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
    assert bundle_in(tmp_path, text.format("model://nothing")) == AssetBundle()


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


class Store(SimClient):
    """Keeps pieces as a server does; fails to answer as often as it was told to."""

    def __init__(self, *, silences: int = 0) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.held: dict[str, bytes] = {}
        self.totals: dict[str, int] = {}
        self.pieces: list[int] = []
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
            self.pieces.append(len(data))
        if self._silences:
            self._silences -= 1
            raise TimeoutError("no answer")
        return len(self.held[sha256])


def a_file(folder: Path, data: bytes) -> AssetFile:
    path = folder / "a.stl"
    path.write_bytes(data)
    return AssetFile(path, hashlib.sha256(data).hexdigest(), len(data))


DATA = bytes(range(256)) * 40_000


@pytest.mark.parametrize("silences", [0, 1, 2])
def test_file_arrives_whole_in_pieces_though_answers_are_lost(
    tmp_path: Path, silences: int
) -> None:
    store, file = Store(silences=silences), a_file(tmp_path, DATA)
    gone: list[int] = []

    send_file(store, find_pending_files(store, [file])[0], gone.append)

    assert store.held[file.sha256] == DATA
    assert max(store.pieces) == MAX_CHUNK_BYTES
    assert sum(gone) == len(DATA)


def test_file_goes_on_from_what_is_there(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, DATA)
    store.held[file.sha256] = DATA[:1_000_000]

    lacking = find_pending_files(store, [file])
    send_file(store, lacking[0], lambda _: None)

    assert lacking == [PendingFile(file, 1_000_000)]
    assert store.held[file.sha256] == DATA
    assert sum(store.pieces) == len(DATA) - 1_000_000


def test_file_that_is_there_is_not_sent(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, DATA)
    send_file(store, PendingFile(file, 0), lambda _: None)

    assert find_pending_files(store, [file]) == []


def test_empty_file_is_sent_once(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, b"")

    send_file(store, find_pending_files(store, [file])[0], lambda _: None)

    assert store.pieces == [0]


def test_sending_ends_when_nothing_arrives(tmp_path: Path) -> None:
    class Deaf(Store):
        def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
            del sha256, offset, total, data
            raise TimeoutError("no answer")

    store, file = Deaf(), a_file(tmp_path, DATA)

    with pytest.raises(TimeoutError, match="0 bytes"):
        send_file(store, PendingFile(file, 0), lambda _: None)


def test_nothing_is_asked_when_there_are_no_files() -> None:
    assert find_pending_files(Store(), []) == []
