"""Limits of GLB files."""

import json

import pytest

from zensim.sim_server.description.meshes.glb_check import GltfError, check_glb_header

HEAD = b"glTF\x02\x00\x00\x00\x00\x00\x00\x00"


def a_glb(**head: object) -> bytes:
    text = json.dumps(head).encode()
    return HEAD + len(text).to_bytes(4, "little") + b"JSON" + text + b"more"


def test_plain_file_is_accepted() -> None:
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
def test_file_is_refused_when_a_count_is_too_large(data: bytes) -> None:
    with pytest.raises(GltfError):
        check_glb_header(data)
