"""Parse a description, URDF or SDF, into a Model and its converted meshes.

Runs in the parser process.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import trimesh

from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.sim_server.description.builtin_models import read_builtin_model, read_builtin_world
from zensim.sim_server.description.meshes.mesh_conversion import (
    MeshConversions,
    MeshFiles,
    convert_meshes,
    list_mesh_uris,
)
from zensim.sim_server.description.meshes.mesh_lookup import HasMesh, no_meshes
from zensim.sim_server.description.sdf.sdf_includes import ResolveInclude, no_includes
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.sdf.sdf_world import WorldModel, read_world
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.spawn_messages import Compat

    FindMesh = Callable[[str], tuple[str, bytes] | None]

_BEFORE_ROOT = re.compile(r"(?:[\ufeff\s]+|<!--.*?-->|<\?.*?\?>)*", re.DOTALL)
_SDF_ROOT = re.compile(r"<sdf[\s/>]")


def read_robot(
    text: str,
    *,
    has_mesh: HasMesh = no_meshes,
    allow_missing: bool = False,
    resolve: ResolveInclude = no_includes,
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


SAMPLE_URDF = """<robot name="sample"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><mesh filename="{0}"/></geometry></visual>
<collision><geometry><mesh filename="{0}"/></geometry></collision></link></robot>"""


@dataclass(frozen=True)
class ModelWithMeshes:
    """A model, and the meshes that it names, by sha256."""

    model: Model
    meshes: dict[str, bytes]


@dataclass(frozen=True)
class WorldWithMeshes:
    """A world, and the meshes that its models name, by sha256."""

    world: WorldModel
    meshes: dict[str, bytes]
    unusable: tuple[str, ...] = ()
    """Why meshes could not be read."""


def parse_description(
    text: str, *, assets: MeshFiles, allow_missing: bool, compat: Compat
) -> ModelWithMeshes:
    """Read a description.

    Args:
        text: URDF or SDF.
        assets: The file behind each mesh URI: its sha256 and its bytes, None when it is not here.
        allow_missing: Leave collisions out whose mesh is not here.
        compat: Whether drives have Gazebo's documented quirks.

    Raises:
        ModelError: The text or a mesh cannot be used.
    """
    present = {uri: (sha, data) for uri, (sha, data) in assets.items() if data is not None}

    def included(uri: str) -> str | None:
        found = present.get(uri)
        return found[1].decode("utf-8", "replace") if found else None

    model = read_robot(
        text, has_mesh=present.__contains__, allow_missing=allow_missing, resolve=included
    )
    made = MeshConversions()
    return ModelWithMeshes(convert_meshes(_set_compat(model, compat), present, made), made.meshes)


def parse_world(
    text: str, *, resolve: ResolveInclude, find_mesh: FindMesh, allow_missing: bool = False
) -> WorldWithMeshes:
    """Read a world and the meshes that it names; what cannot be used is reported and left out.

    Args:
        text: SDF with one <world>.
        resolve: Finds the text of an included model.
        find_mesh: Finds a mesh by its URI: its sha256 and its bytes.
        allow_missing: Leave included models out that are not here.

    Raises:
        ModelError: The text is no SDF world, or describes what cannot be.
    """
    world = read_world(
        text,
        resolve=resolve,
        has_mesh=lambda uri: find_mesh(uri) is not None,
        allow_missing=allow_missing,
    )
    made, models, notes = MeshConversions(), [], list(world.report)
    unusable: list[str] = []
    for placed in world.models:
        files = {uri: file for uri in list_mesh_uris(placed.model) if (file := find_mesh(uri))}
        try:
            model = convert_meshes(placed.model, files, made)
        except ModelError as error:
            notes.append(ReportEntry("suspicious", f"model '{placed.name}'", f"left out: {error}"))
            unusable.append(str(error))
            continue
        new = model.report[len(placed.model.report) :]
        unusable += [note.reason for note in new]
        notes += [
            msgspec.structs.replace(note, subject=f"{placed.name}: {note.subject}") for note in new
        ]
        models.append(msgspec.structs.replace(placed, model=model))
    whole = msgspec.structs.replace(world, models=tuple(models), report=tuple(notes))
    return WorldWithMeshes(whole, made.meshes, tuple(unusable))


def _set_compat(model: Model, compat: Compat) -> Model:
    replace = msgspec.structs.replace
    if model.ground_truths:
        truths = tuple(replace(truth, compat=compat) for truth in model.ground_truths)
        model = replace(model, ground_truths=truths)
    if model.drive is None or model.drive.compat == compat:
        return model
    return replace(model, drive=replace(model.drive, compat=compat))


def warm_up() -> None:
    """Read a sample of everything: once no file can be opened, nothing can be imported."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    tetrahedron = trimesh.Trimesh(corners, sides)
    for ending in ("stl", "obj", "dae", "glb"):
        exported = tetrahedron.export(file_type=ending)
        data = exported.encode() if isinstance(exported, str) else exported
        assert isinstance(data, bytes)
        name = f"a.{ending}"
        parse_description(
            SAMPLE_URDF.format(name), assets={name: ("", data)}, allow_missing=False, compat="fixed"
        )
    for text in ("", "<robot", read_builtin_model("box_bot")):
        with suppress(ModelError):
            parse_description(text, assets={}, allow_missing=False, compat="fixed")
    parse_world(read_builtin_world("walls"), resolve=no_includes, find_mesh=lambda _: None)
