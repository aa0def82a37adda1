"""Each bad mesh is refused with its slug."""

import pytest

from tests.hostile.case import alone, solid
from tests.hostile.meshes import BadMesh, bad_meshes
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.errors import ModelError


@pytest.mark.parametrize("bad", list(bad_meshes()), ids=lambda bad: bad.name)
def test_bad_mesh_is_refused_with_its_slug(bad: BadMesh) -> None:
    text = alone(solid(f'<mesh filename="{bad.name}"/>'))

    with pytest.raises(ModelError) as refusal:
        parse_description(
            text, assets={bad.name: ("0" * 64, bad.data)}, allow_missing=False, compat="fixed"
        )

    assert refusal.value.slug == bad.slug
