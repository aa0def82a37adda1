"""A mesh with its image is one file of glTF."""

import msgspec
import numpy as np
import pytest

from zensim.spawner.page.glb_encoding import encode_glb
from zensim.spawner.page.model_visuals import ColouredMesh, make_textured_mesh

SQUARE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32
)
PNG = b"\x89PNG and more"


@pytest.mark.parametrize(
    ("image", "alpha", "mode"),
    [(PNG, 1.0, "MASK"), (PNG, 0.5, "BLEND"), (b"\xff\xd8\xff", 1.0, "OPAQUE")],
)
def test_glb_holds_mesh_and_image(image: bytes, alpha: float, mode: str) -> None:
    mesh = make_textured_mesh(SQUARE, np.arange(12, dtype=np.float32).reshape(-1, 2), image)

    data = encode_glb(ColouredMesh(mesh, (1.0, 0.5, 0.0, alpha), is_smooth=False, has_file=True))

    assert int.from_bytes(data[8:12], "little") == len(data)
    head = int.from_bytes(data[12:16], "little")
    content = msgspec.json.decode(data[20 : 20 + head])
    body = data[28 + head :]
    parts = [body[v["byteOffset"] :][: v["byteLength"]] for v in content["bufferViews"]]
    assert np.frombuffer(parts[0], "<f4").tolist() == SQUARE.ravel().tolist()
    assert np.frombuffer(parts[1], "<f4")[:4].tolist() == [0.0, 0.0, 2.0, -2.0]
    assert parts[3] == image
    assert content["materials"][0]["alphaMode"] == mode
