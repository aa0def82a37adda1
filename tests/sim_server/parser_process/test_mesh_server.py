"""Files of spawned descriptions by http: what is offered, and what hostile clients get."""

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote, urlsplit
from urllib.request import Request, urlopen

import pytest

from tests.integration.processes import eventually
from zensim.proto.bounded_http_server import MAX_CONNECTIONS
from zensim.proto.messages.asset_messages import AssetRef
from zensim.sim_server.parser_process.mesh_server import MAX_BUNDLES, MeshServer, PublishedFiles

BASE, IMAGE, SECRET = b"solid base", b"an image", b"of another user"
URI = "package://robot/meshes/base & top.dae"
TEXTURE = "package://robot/materials/textures/wood.png"
TEXT = """<robot name="r"><link name="base"><visual><geometry>
<mesh filename="package://robot/meshes/base &amp; top.dae" scale="1 1 1"/></geometry></visual>
<visual><geometry><mesh filename='package://other/lost.stl'/></geometry></visual></link></robot>"""
WITHIN_S = 5.0


def name_of(data: bytes) -> str:
    return sha256(data).hexdigest()


FILES = (AssetRef(URI, name_of(BASE)), AssetRef(TEXTURE, name_of(IMAGE)))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for data in (BASE, IMAGE, SECRET):
        (tmp_path / f"{name_of(data)}.stl").write_bytes(data)
    return tmp_path


@pytest.fixture
def server(folder: Path) -> Iterator[MeshServer]:
    with closing(MeshServer("127.0.0.1:0", str(folder))) as found:
        yield found


def find_url(server: MeshServer) -> str:
    """Find the URL of the first mesh in the description that the server publishes."""
    text = server.files.publish(TEXT, FILES)
    return text.partition('filename="')[2].partition('"')[0]


def get(server: MeshServer, path: str, method: str = "GET") -> int:
    """Send a path as it is, and return the status."""
    host, port = str(server.server_address[0]), int(server.server_address[1])
    with closing(http.client.HTTPConnection(host, port, timeout=5.0)) as client:
        client.putrequest(method, path)
        client.endheaders()
        return client.getresponse().status


def read(url: str) -> bytes:
    with urlopen(url, timeout=5.0) as response:
        return bytes(response.read())


def test_description_names_files_by_urls_that_have_their_bytes(server: MeshServer) -> None:
    url = find_url(server)

    assert url.endswith("/robot/meshes/base%20%26%20top.dae")
    assert read(url) == BASE
    assert "package://other/lost.stl" in server.files.publish(TEXT, FILES)


def test_texture_is_found_relative_to_its_mesh(server: MeshServer) -> None:
    folder = find_url(server).rpartition("/")[0]

    path = urlsplit(f"{folder}/../materials/textures/wood.png").path

    assert get(server, path) == 200
    assert read(f"{folder.rpartition('/')[0]}/materials/textures/wood.png") == IMAGE


def test_head_has_the_length_and_type(server: MeshServer) -> None:
    with urlopen(Request(find_url(server), method="HEAD"), timeout=5.0) as response:
        assert response.headers["Content-Length"] == str(len(BASE))
        assert response.headers["Content-Type"] == "model/vnd.collada+xml"
        assert response.read() == b""


def test_nothing_else_is_served(server: MeshServer, folder: Path) -> None:
    bundle = urlsplit(find_url(server)).path.split("/")[1]
    (folder / "outside.stl").write_bytes(SECRET)
    tried = (
        "/",
        f"/{bundle}",
        f"/{bundle}/",
        f"/{bundle}/../{name_of(SECRET)}.stl",
        f"/{name_of(SECRET)}",
        f"/{name_of(BASE)}.stl",
        "/outside.stl",
        "/etc/passwd",
        "/../../../../etc/passwd",
        "/..%2f..%2f..%2fetc%2fpasswd",
        f"/{bundle}/robot/meshes/../../../../../etc/passwd",
        f"/{bundle}/%2e%2e/%2e%2e/etc/passwd",
        f"/{bundle}/robot/meshes/base%00.dae",
        f"/{bundle}/{quote(str(folder / 'outside.stl'))}",
        f"//{bundle}//",
        "/%ff%fe",
    )

    assert {path: get(server, path) for path in tried} == dict.fromkeys(tried, 404)


def test_file_that_was_evicted_is_not_found(server: MeshServer, folder: Path) -> None:
    url = find_url(server)
    (folder / f"{name_of(BASE)}.stl").unlink()

    assert get(server, urlsplit(url).path) == 404


def test_link_in_the_folder_is_not_followed(server: MeshServer, folder: Path) -> None:
    url = find_url(server)
    (folder / f"{name_of(BASE)}.stl").unlink()
    (folder / f"{name_of(BASE)}.stl").symlink_to("/etc/hostname")

    assert get(server, urlsplit(url).path) == 404


def test_only_reading_is_possible(server: MeshServer) -> None:
    path = urlsplit(find_url(server)).path

    for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
        assert get(server, path, method) == 501


def test_secret_is_a_part_of_each_url(folder: Path) -> None:
    with closing(MeshServer("127.0.0.1:0", str(folder), has_secret=True)) as server:
        url = find_url(server)
        bare = urlsplit(url).path.replace(f"/{server.secret}", "")

        assert read(url) == BASE
        assert len(server.secret) >= 32
        assert get(server, bare) == 404
        assert get(server, f"/{server.secret[:-1]}{bare}") == 404
        assert get(server, f"/{bare}") == 404


def test_connections_whose_threads_cannot_start_are_forgotten(
    server: MeshServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        for _ in range(MAX_CONNECTIONS):
            with socket.create_connection(server.server_address[:2], WITHIN_S) as client:  # type: ignore[arg-type]
                assert client.recv(1) == b""

    assert server.count_connections() == 0
    assert read(find_url(server)) == BASE


def test_silent_connections_are_bounded_and_end(
    server: MeshServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = find_url(server)
    with ExitStack() as stack:
        for _ in range(2 * MAX_CONNECTIONS):
            stack.enter_context(socket.create_connection(server.server_address[:2], 5.0))  # type: ignore[arg-type]
        eventually(lambda: server.count_connections() == MAX_CONNECTIONS, WITHIN_S, "connections")
        monkeypatch.setattr(server, "longest_s", 0.0)
        eventually(lambda: server.count_connections() == 0, WITHIN_S, "their end")
        monkeypatch.undo()

        assert read(url) == BASE


def test_garbage_ends_its_connection_only(server: MeshServer) -> None:
    url = find_url(server)
    for sent in (b"\x00" * 100, b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"A" * 70_000):
        with closing(socket.create_connection(server.server_address[:2], 5.0)) as client:  # type: ignore[arg-type]
            client.sendall(sent)

    assert read(url) == BASE


def test_sets_of_files_are_forgotten_in_turn() -> None:
    files = PublishedFiles("http://h/")
    first = files.publish('<mesh filename="a.stl"/>', (AssetRef("a.stl", "0"),))
    for number in range(MAX_BUNDLES):
        files.publish(f'<mesh filename="{number}.stl"/>', (AssetRef(f"{number}.stl", "1"),))

    bundle = first.partition("http://h/")[2].partition("/")[0]
    assert files.find(f"{bundle}/a.stl") == ""


def test_equal_descriptions_have_equal_urls() -> None:
    files = PublishedFiles("http://h/")

    assert files.publish(TEXT, FILES) is files.publish(TEXT, FILES)
    assert files.publish(TEXT, ()) == TEXT


def test_taken_address_is_refused(server: MeshServer, folder: Path) -> None:
    with pytest.raises(OSError, match="use"):
        MeshServer(f"127.0.0.1:{server.server_address[1]}", str(folder))
