"""A description's text to Model and meshes, whatever its format: what the reader process does."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import trimesh

from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.formats import read_robot
from zensim.sim_server.description.library import model_text, world_text
from zensim.sim_server.description.meshes import Conversions, Files, mesh_uris, with_meshes
from zensim.sim_server.description.sdf import WorldModel, read_world
from zensim.sim_server.description.sdf_includes import no_includes
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.model_messages import Model
    from zensim.proto.messages.spawn_messages import Compat
    from zensim.sim_server.description.sdf_includes import Resolve

    FindMesh = Callable[[str], tuple[str, bytes] | None]

SAMPLE = """<robot name="sample"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><mesh filename="{0}"/></geometry></visual>
<collision><geometry><mesh filename="{0}"/></geometry></collision></link></robot>"""


@dataclass(frozen=True)
class Described:
    """A model, and the meshes that it names, by sha256."""

    model: Model
    meshes: dict[str, bytes]


@dataclass(frozen=True)
class DescribedWorld:
    """A world, and the meshes that its models name, by sha256."""

    world: WorldModel
    meshes: dict[str, bytes]
    unusable: tuple[str, ...] = ()
    """Why meshes could not be read."""


def describe(text: str, *, assets: Files, allow_missing: bool, compat: Compat) -> Described:
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
    made = Conversions()
    return Described(with_meshes(_with_compat(model, compat), present, made), made.meshes)


def describe_world(
    text: str, *, resolve: Resolve, find_mesh: FindMesh, allow_missing: bool = False
) -> DescribedWorld:
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
    made, models, notes = Conversions(), [], list(world.report)
    unusable: list[str] = []
    for placed in world.models:
        files = {uri: file for uri in mesh_uris(placed.model) if (file := find_mesh(uri))}
        try:
            model = with_meshes(placed.model, files, made)
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
    return DescribedWorld(whole, made.meshes, tuple(unusable))


def _with_compat(model: Model, compat: Compat) -> Model:
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
        describe(
            SAMPLE.format(name), assets={name: ("", data)}, allow_missing=False, compat="fixed"
        )
    for text in ("", "<robot", model_text("box_bot")):
        with suppress(ModelError):
            describe(text, assets={}, allow_missing=False, compat="fixed")
    describe_world(world_text("walls"), resolve=no_includes, find_mesh=lambda _: None)
