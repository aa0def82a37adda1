"""A robot's text to Model, URDF or SDF by what its root says."""

import re

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.assets import HasMesh, no_meshes
from zensim.sim_server.description.sdf_includes import Resolve, no_includes
from zensim.sim_server.description.sdf_model import read_sdf_model
from zensim.sim_server.description.urdf import read_urdf

_BEFORE_ROOT = re.compile(r"(?:[\ufeff\s]+|<!--.*?-->|<\?.*?\?>)*", re.DOTALL)
_SDF_ROOT = re.compile(r"<sdf[\s/>]")


def read_robot(
    text: str,
    *,
    has_mesh: HasMesh = no_meshes,
    allow_missing: bool = False,
    resolve: Resolve = no_includes,
) -> Model:
    """Read a robot; as `read_urdf` and `read_sdf_model`, which one the root tag tells.

    Raises:
        ModelError: The text is neither, or describes what cannot be.
    """
    if is_sdf(text):
        return read_sdf_model(text, has_mesh=has_mesh, allow_missing=allow_missing, resolve=resolve)
    return read_urdf(text, has_mesh=has_mesh, allow_missing=allow_missing)


def is_sdf(text: str) -> bool:
    """Whether the first tag of a text, comments and instructions apart, is <sdf>."""
    before = _BEFORE_ROOT.match(text)
    return _SDF_ROOT.match(text, before.end() if before else 0) is not None
