"""Files of a world for a recording: those of the server, and no others of the host."""

import hashlib
import os
from pathlib import Path
from typing import cast

import pytest

from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.spawn_messages import Resource
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.messages.world_messages import GetCurrentWorldResponse, WorldResource
from zensim.proto.service_catalog import GET_ASSET, GET_CURRENT_WORLD, Request, Response, Service
from zensim.recording import entity_files
from zensim.recording.entity_files import EntityFiles, FileRefused, read_world_file
from zensim.recording.mcap_records import AttachedFile


def name_world(uri: str, text: str = "") -> WorldResource:
    return WorldResource(world_resource=Resource(uri, text))


class OwnServer:
    """Replies with one model that has one mesh."""

    def __init__(self, mesh: bytes, total: int, uri: str = "empty") -> None:
        self.mesh, self.total, self.uri = mesh, total, uri
        self.sha256 = hashlib.sha256(mesh[:total]).hexdigest()
        self.calls = 0

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        del world, timeout_s, request_id
        self.calls += 1
        if service is GET_CURRENT_WORLD:
            return cast("Response", GetCurrentWorldResponse(world=name_world(self.uri)))
        if service is GET_ASSET:
            assert isinstance(request, GetAssetRequest)
            part = self.mesh[request.offset : request.offset + 10]
            return cast("Response", GetAssetResponse(data=part, total=self.total))
        shape = Shape("mesh", mesh=self.sha256)
        model = Model(name="m", links=(Link(name="base", visuals=(shape,)),))
        return cast("Response", GetModelsResponse(models=(model,)))


def attach(server: OwnServer, most_s: float = 10.0) -> tuple[list[AttachedFile], list[str]]:
    attached: list[AttachedFile] = []
    refused: list[str] = []
    files = EntityFiles(server, "default", attached.append, refused.append)
    files.attach_new(has_arrivals=True, most_s=most_s)
    files.attach_new(has_arrivals=True, most_s=most_s)
    return attached, refused


def test_world_models_and_meshes_are_attached_once() -> None:
    server = OwnServer(b"0123456789abcde", 15)

    attached, refused = attach(server)

    assert [one.name.split("/")[0] for one in attached] == ["world.sdf", "models", "meshes"]
    assert attached[-1].content == server.mesh
    assert refused == []


@pytest.mark.parametrize("sent", [b"0123456789abcdX", b"0123456789", b""])
def test_mesh_whose_bytes_are_others_is_left_out(sent: bytes) -> None:
    server = OwnServer(b"0123456789abcde", 15)
    server.mesh = sent

    attached, refused = attach(server)

    assert [one.name for one in attached if one.name.startswith("meshes/")] == []
    assert len(refused) == 1


def test_mesh_beyond_the_limit_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entity_files, "MAX_FILE_BYTES", 100)
    server = OwnServer(bytes(10_000), 1 << 60)

    attached, refused = attach(server)

    assert [one.name for one in attached if one.name.startswith("meshes/")] == []
    assert len(refused) == 1
    assert server.calls < 20


def test_meshes_of_a_recording_have_a_limit_in_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entity_files, "MAX_MESHES_BYTES", 100)

    attached, refused = attach(OwnServer(bytes(10_000), 10_000))

    assert [one.name for one in attached if one.name.startswith("meshes/")] == []
    assert len(refused) == 1


def test_slow_server_does_not_hold_up_the_recorder() -> None:
    server = OwnServer(bytes(100_000), 100_000)

    attach(server, most_s=0.0)

    assert server.calls == 4  # of worlds and models only


def test_shipped_world_and_text_of_a_world_are_read() -> None:
    assert "<sdf" in read_world_file(name_world("empty"))
    assert read_world_file(name_world("", "<sdf/>")) == "<sdf/>"
    assert read_world_file(name_world("/nowhere/own.sdf")) == ""


def test_world_file_of_this_host_is_read(tmp_path: Path) -> None:
    file = tmp_path / "own.sdf"
    file.write_text('<?xml version="1.0"?>\n<sdf version="1.9"><world/></sdf>')

    assert read_world_file(name_world(f"file://{file}")) == file.read_text()


def make_pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.sdf")
    return folder / "pipe.sdf"


def make_large(folder: Path) -> Path:
    file = folder / "large.sdf"
    file.write_bytes(b"<sdf >" + bytes(entity_files.MAX_WORLD_BYTES))
    return file


def make_text(folder: Path) -> Path:
    file = folder / "notes.sdf"
    file.write_text("my notes")
    return file


def make_other(folder: Path) -> Path:
    file = folder / "secret.txt"
    file.write_text("<sdf version='1.9'>")
    return file


def make_bytes(folder: Path) -> Path:
    file = folder / "bytes.sdf"
    file.write_bytes(b"<sdf \xff")
    return file


@pytest.mark.parametrize("make", [make_pipe, make_large, make_text, make_other, make_bytes])
def test_file_of_this_host_that_is_no_world_is_refused(tmp_path: Path, make: object) -> None:
    file = make(tmp_path)  # type: ignore[operator]
    with pytest.raises(FileRefused):
        read_world_file(name_world(str(file)))

    attached, refused = attach(OwnServer(b"", 0, str(file)))

    assert "world.sdf" not in [one.name for one in attached]
    assert len(refused) == 1
