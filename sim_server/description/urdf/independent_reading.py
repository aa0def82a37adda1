"""A second reading of URDF, by yourdfpy, compared with the Model that the engines get.

The only importer of yourdfpy. Its import takes 2 s of CPU, so no spawn
waits for it.
"""

from __future__ import annotations

import logging
from importlib.util import find_spec
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import FloatArray, from_origin, to_matrix
from zensim.sim_server.description.model_geometry import find_link_poses

if TYPE_CHECKING:
    from collections.abc import Iterator

    import yourdfpy

    from zensim.proto.messages.model_messages import Model

logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)  # its faults are lines of the answer
TOLERANCE = 1e-6
"""Tolerance of poses [m] and rotation matrices, and relative to the whole mass."""
WORLD_LINK = "world"
NOT_INSTALLED = (
    "yourdfpy is not installed, so that URDF is not compared with a second reading; "
    "use pip install 'zensim[server]'"
)


def has_other_reader() -> bool:
    """Whether yourdfpy is installed."""
    return find_spec("yourdfpy") is not None


def find_reading_differences(text: str, model: Model) -> tuple[str, ...]:
    """Compare links, their poses with all joints at 0, and the mass with yourdfpy's reading.

    Args:
        text: URDF that was read as `model`; xacro is expanded.
        model: What zensim simulates.

    Returns:
        One line for each difference; one line if yourdfpy cannot read the text.

    Raises:
        ModuleNotFoundError: yourdfpy is not installed; see `has_other_reader`.
    """
    import yourdfpy

    try:
        other = yourdfpy.URDF.load(BytesIO(text.encode()), load_meshes=False)
        return tuple(_compare(other, model))
    except Exception as error:  # noqa: BLE001 - any fault of the other reader is its answer
        return (f"yourdfpy cannot read it: {' '.join(str(error).split())[:200]}",)


def _compare(other: yourdfpy.URDF, model: Model) -> Iterator[str]:
    ours, theirs = _find_poses(model), {link.name for link in other.robot.links} - {WORLD_LINK}
    if missing := sorted(theirs - ours.keys()):
        yield f"links {', '.join(missing)} are missing"
    if added := sorted(ours.keys() - theirs - {WORLD_LINK}):
        yield f"links {', '.join(added)} are added"
    root = model.links[0].name
    for name in sorted(ours.keys() & theirs):
        error = float(np.abs(ours[name] - other.get_transform(name, root)).max())
        if error > TOLERANCE:
            yield f"link {name} is placed elsewhere, by {error:.3g}"
    inertials = [link.inertial for link in other.robot.links if link.name != WORLD_LINK]
    mass = sum(inertial.mass or 0.0 for inertial in inertials if inertial is not None)
    if abs(mass - model.mass_kg) > TOLERANCE * mass:
        yield f"the mass is {model.mass_kg:.6g} kg, not {mass:.6g} kg"


def _find_poses(model: Model) -> dict[str, FloatArray]:
    """Find the pose (4, 4) of each link of the description in the root link."""
    moving = find_link_poses(model.links[0].name, model.joints)
    poses = {name: _to_transform(from_origin(pose)) for name, pose in moving.items()}
    for frame in model.frames:
        poses[frame.name] = poses[frame.parent] @ _to_transform(from_origin(frame.origin))
    return poses


def _to_transform(pose: FloatArray) -> FloatArray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = to_matrix(pose[3:]), pose[:3]
    return transform
