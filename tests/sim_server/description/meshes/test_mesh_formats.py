"""OBJ: however it is written, the same triangles."""

import json

import pytest

from zensim.sim_server.description.meshes.mesh_formats import (
    CHUNK_BYTES,
    GltfError,
    ObjSyntaxError,
    TooManyInstances,
    check_collada_instances,
    check_glb_header,
    read_obj,
)

DRAWN = '<instance_geometry url="#g"/>'


def a_scene(*nodes: str) -> bytes:
    return f'<COLLADA xmlns="urn:c">{"".join(nodes)}</COLLADA>'.encode()


def a_node(name: str, *parts: str) -> str:
    return f'<node id="{name}">{"".join(parts)}</node>'


def naming(*names: str) -> str:
    return "".join(f'<instance_node url="#{name}"/>' for name in names)


def doubled(times: int) -> bytes:
    above = (a_node(f"n{i}", naming(f"n{i - 1}", f"n{i - 1}")) for i in range(1, times))
    return a_scene(a_node("n0", DRAWN), *above)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", DRAWN * 20_000)),
        a_scene(a_node("a", DRAWN, naming("ghost"))),
        a_scene(a_node("a", DRAWN), a_node("b", naming("a", "a"), a_node("c", naming("a")))),
        doubled(10),
    ],
)
def test_nodes_are_taken_when_they_draw_little(data: bytes) -> None:
    check_collada_instances(data)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", naming("a"))),
        a_scene(a_node("a", naming("b")), a_node("b", naming("c")), a_node("c", naming("a"))),
        doubled(30),
        doubled(3000),
    ],
)
def test_nodes_are_refused_when_they_draw_without_end(data: bytes) -> None:
    with pytest.raises(TooManyInstances):
        check_collada_instances(data)


HEAD = b"glTF\x02\x00\x00\x00\x00\x00\x00\x00"


def a_glb(**head: object) -> bytes:
    text = json.dumps(head).encode()
    return HEAD + len(text).to_bytes(4, "little") + b"JSON" + text + b"more"


def test_plain_file_is_taken() -> None:
    check_glb_header(a_glb(accessors=[{"count": 12}], nodes=[{"children": [1]}, {"mesh": 0}]))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        HEAD + b"\xff\xff\xff\xffJSON{",
        HEAD + b"\x60\x00\x00\x00JSON" + b"[" * 96,
        a_glb(accessors=[{"count": 10**12}]),
        a_glb(accessors=[{"count": -1}]),
        a_glb(accessors=[{"count": "many"}]),
        a_glb(nodes=[{"children": [1, 1]}, {}]),
        a_glb(nodes=[{}] * 10_001),
        a_glb(extensionsRequired=["KHR_draco_mesh_compression"]),
    ],
)
def test_file_that_promises_too_much_is_refused(data: bytes) -> None:
    with pytest.raises(GltfError):
        check_glb_header(data)


MOST = 10_000
SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
FANS = {(0, 1, 2), (0, 2, 3)}


def triangles(data: bytes) -> set[tuple[int, ...]]:
    _, faces = read_obj(data, MOST)
    return {tuple(face) for face in faces.tolist()}


@pytest.mark.parametrize(
    "face",
    [
        b"f 1 2 3 4",
        b"f 1/1 2/2 3/3 4/4",
        b"f 1//9 2//9 3/8/9 4",
        b"f 1 2 3\nf 1 3 4",
        b"f 1 2 3\n#\ns off\nvn 0 0 1\nf 1 3 4",
        b"f -4 -3 -2 -1",
        b"f 1 2 \\\n3 4",
        b"  f\t1 2 3 4",
        b"f\t1\t2\t3\t4",
    ],
)
def test_faces_are_read_however_they_are_written(face: bytes) -> None:
    assert triangles(SQUARE + face) == FANS


@pytest.mark.parametrize(
    "tail", [b"v 5 5 5\n", b"v 5 5 5 1\n", b"v 5 5 5 .1 .2 .3\n", b"  v 5 5 5\n"]
)
def test_corners_are_read_with_what_stands_behind(tail: bytes) -> None:
    corners, _ = read_obj(SQUARE + tail, MOST)

    assert corners.tolist()[-2:] == [[0.0, 1.0, 0.0], [5.0, 5.0, 5.0]]


def test_faces_of_many_kinds_are_read_at_once() -> None:
    assert triangles(SQUARE + b"f 1 2\nf 1\nf 1 2 3\nf 2 3 4 1\n") == {
        (0, 1, 2),
        (1, 2, 3),
        (1, 3, 0),
    }


def test_face_of_very_many_sides_is_read() -> None:
    corners = b"v 0 0 0\n" * 1000
    face = b"f " + b" ".join(b"%d" % i for i in range(1, 1001))

    assert len(triangles(corners + face)) == 998


@pytest.mark.parametrize(
    "line", [b"v 1 2", b"v one 2 3", b"f 1 2 x", b"f 1 // 3", b"v 1/2 3 4", b"f 1 2 \xff"]
)
def test_line_that_is_none_is_named(line: bytes) -> None:
    with pytest.raises(ObjSyntaxError) as refused:
        read_obj(SQUARE + line, MOST)

    assert refused.value.line == line


def test_nothing_is_read_from_nothing() -> None:
    corners, faces = read_obj(b"", MOST)

    assert (corners.shape, faces.shape) == ((0, 3), (0, 3))


@pytest.mark.parametrize("face", ["f 1 2 99999999999999999999", "f " + "1 2 3 " * 4000])
def test_face_that_no_mesh_has_is_named(face: str) -> None:
    with pytest.raises(ObjSyntaxError):
        read_obj(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n".encode(), MOST)


def test_faces_name_corners_that_stand_far_before_them() -> None:
    far = b"# nothing to see here\n" * (CHUNK_BYTES // 20)

    assert triangles(SQUARE + far + b"f -4 2 3 -1\n") == FANS


def test_reading_ends_where_there_are_too_many_triangles() -> None:
    piece = SQUARE + b"f 1 2 3\n" * (CHUNK_BYTES // 8)

    _, faces = read_obj(piece + b"no end of it\n" * CHUNK_BYTES, len(piece) // 10)

    assert len(faces) < CHUNK_BYTES // 8


def test_line_without_end_is_none() -> None:
    with pytest.raises(ObjSyntaxError) as refused:
        read_obj(SQUARE + b"f " + b"1 2 3 " * CHUNK_BYTES, MOST)

    assert len(refused.value.line) < 1000
