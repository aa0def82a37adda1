"""OBJ files in each notation."""

import pytest

from zensim.sim_server.description.meshes.obj_reader import CHUNK_BYTES, ObjSyntaxError, read_obj

MOST = 10_000
SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
FANS = {(0, 1, 2), (0, 2, 3)}


def triangles(data: bytes) -> set[tuple[int, ...]]:
    faces = read_obj(data, MOST).faces
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
        b"# square\nf 1 2 3 4 # all corners\n #",
    ],
)
def test_faces_are_read_in_each_notation(face: bytes) -> None:
    assert triangles(SQUARE + face) == FANS


@pytest.mark.parametrize(
    "tail", [b"v 5 5 5\n", b"v 5 5 5 1\n", b"v 5 5 5 .1 .2 .3\n", b"  v 5 5 5\n"]
)
def test_vertices_are_read_when_other_values_follow(tail: bytes) -> None:
    corners = read_obj(SQUARE + tail, MOST).corners

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
def test_invalid_line_is_in_the_error(line: bytes) -> None:
    with pytest.raises(ObjSyntaxError) as refused:
        read_obj(SQUARE + line, MOST)

    assert refused.value.line == line


def test_empty_file_has_no_triangles() -> None:
    content = read_obj(b"", MOST)
    corners, faces = content.corners, content.faces

    assert (corners.shape, faces.shape) == ((0, 3), (0, 3))


@pytest.mark.parametrize("face", ["f 1 2 99999999999999999999", "f " + "1 2 3 " * 4000])
def test_invalid_face_is_in_the_error(face: str) -> None:
    with pytest.raises(ObjSyntaxError):
        read_obj(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n".encode(), MOST)


def test_faces_may_use_corners_of_earlier_chunks() -> None:
    far = b"# nothing to see here\n" * (CHUNK_BYTES // 20)

    assert triangles(SQUARE + far + b"f -4 2 3 -1\n") == FANS


def test_reading_stops_after_too_many_triangles() -> None:
    piece = SQUARE + b"f 1 2 3\n" * (CHUNK_BYTES // 8)

    faces = read_obj(piece + b"no end of it\n" * CHUNK_BYTES, len(piece) // 10).faces

    assert len(faces) < CHUNK_BYTES // 8


def test_endless_line_is_refused() -> None:
    with pytest.raises(ObjSyntaxError) as refused:
        read_obj(SQUARE + b"f " + b"1 2 3 " * CHUNK_BYTES, MOST)

    assert len(refused.value.line) < 1000
