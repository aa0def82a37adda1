"""Parse a description, URDF or SDF, into a Model and its converted meshes.

Runs in the parser process.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.sim_server.description.builtin_models import read_builtin_model, read_builtin_world
from zensim.sim_server.description.joint_reduction import LumpedModel
from zensim.sim_server.description.meshes.mesh_lookup import has_assets
from zensim.sim_server.description.meshes.mesh_triangles import FindFile, find_no_file
from zensim.sim_server.description.model_geometry import FALL, falls_without_end
from zensim.sim_server.description.parsed_model import has_no_moments
from zensim.sim_server.description.plugins.drive_selection import select_drive
from zensim.sim_server.description.plugins.joint_controllers import add_joint_controllers
from zensim.sim_server.description.plugins.sensor_reader import complete_sensors
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_xml import find_root_tag
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.description.wheel_contacts import describe_contacts
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    import numpy.typing as npt

    from zensim.proto.messages.spawn_messages import Compat
    from zensim.sim_server.description.meshes.mesh_conversion import MeshFiles
    from zensim.sim_server.description.model_geometry import FindCorners
    from zensim.sim_server.description.sdf.sdf_includes import ResolveInclude
    from zensim.sim_server.description.world_model import WorldModel


DESCRIBED_DRIVE = DriveOrder()
SDF_ROOTS = ("sdf", "gazebo")
"""<gazebo version="1.2"> is SDF of 2012."""


def read_robot(
    text: str,
    *,
    find_mesh: FindFile = find_no_file,
    allow_missing: bool = False,
    resolve: ResolveInclude | None = None,
) -> Model:
    """Read a robot with `read_sdf_model` or `read_urdf`, depending on the root tag."""
    if is_sdf(text):
        from zensim.sim_server.description.sdf.sdf_includes import no_includes
        from zensim.sim_server.description.sdf.sdf_model import read_sdf_model

        resolve = resolve or no_includes
        return read_sdf_model(
            text, find_mesh=find_mesh, allow_missing=allow_missing, resolve=resolve
        )
    return read_urdf(text, find_mesh=find_mesh, allow_missing=allow_missing)


def is_sdf(text: str) -> bool:
    """Whether the root tag of a text is <sdf>, or <gazebo> as before SDF 1.3."""
    return find_root_tag(text) in SDF_ROOTS


SAMPLE_WITHOUT_DRIVE = """<robot name="r"><link name="a"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="3" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="b"/>
<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""
"""A wheel that nothing drives, and moments that no body can have."""
SAMPLE_URDF = """<robot name="sample"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><mesh filename="{0}"/></geometry></visual>
<collision><geometry><mesh filename="{0}"/></geometry></collision></link></robot>"""
SAMPLE_SDF = """<sdf version="1.11"><model name="m"><link name="a"><inertial auto="true"/>
<collision name="c"><geometry><mesh><uri>{0}</uri></mesh></geometry></collision>
</link></model></sdf>"""
"""A mesh whose volume is measured."""


@dataclass(frozen=True)
class ModelWithMeshes:
    """A model, and its meshes and textures by sha256."""

    model: Model
    meshes: dict[str, bytes]


@dataclass(frozen=True)
class WorldWithMeshes:
    """A world, and the meshes and textures of its models by sha256."""

    world: WorldModel
    meshes: dict[str, bytes]
    unusable: tuple[str, ...] = ()
    """Errors of meshes that could not be read."""


def parse_description(
    text: str,
    *,
    assets: MeshFiles,
    allow_missing: bool,
    compat: Compat,
    controllers: Sequence[str] = (),
    drive: DriveOrder = DESCRIBED_DRIVE,
) -> ModelWithMeshes:
    """Parse a URDF or SDF model and convert its meshes.

    Args:
        text: URDF or SDF.
        assets: sha256 and bytes (None when missing) by mesh or include URI.
        allow_missing: Leave out collisions whose mesh is missing.
        compat: Whether drives reproduce Gazebo's documented quirks.
        controllers: Texts of controllers' files.
        drive: Of the request.

    Raises:
        ModelError: The text or a mesh is invalid.
    """
    present = {uri: (sha, data) for uri, (sha, data) in assets.items() if data is not None}

    def included(uri: str) -> str | None:
        found = present.get(uri)
        return found[1].decode("utf-8", "replace") if found else None

    model = read_robot(text, find_mesh=present.get, allow_missing=allow_missing, resolve=included)
    found = ModelWithMeshes(model, {})
    if has_assets(model):
        found = _convert_meshes(model, present.get, overrides_materials=is_sdf(text))
    model = _set_compat(_add_drive(found, controllers, drive), compat)
    model = complete_sensors(model, compat)
    return ModelWithMeshes(_add_notes(model, found.meshes), found.meshes)


def _convert_meshes(
    model: Model, find_file: FindFile, *, overrides_materials: bool
) -> ModelWithMeshes:
    from zensim.sim_server.description.meshes.mesh_conversion import MeshConversions, convert_meshes

    conversions = MeshConversions()
    converted = convert_meshes(
        model, find_file, conversions, overrides_materials=overrides_materials
    )
    return ModelWithMeshes(converted, conversions.meshes)


def _add_drive(read: ModelWithMeshes, controllers: Sequence[str], order: DriveOrder) -> Model:
    def find_corners(mesh: str) -> npt.NDArray[np.floating]:
        from zensim.proto.stl import read_corners

        return read_corners(read.meshes[mesh])

    model, report = read.model, ParseReport()
    lumped = LumpedModel(model.links, model.joints, model.frames, find_corners)
    driven = select_drive(model, lumped, controllers=controllers, order=order, report=report)
    may_drive = bool(model.joints or controllers) and order.kind != "none" and not model.is_static
    if driven.drive is None and may_drive:
        # Most robots have a drive, and the trial of one imports numpy.
        from zensim.sim_server.description.drive_suggestion import report_missing_drive

        report_missing_drive(driven, lumped, report, is_controlled=bool(controllers))
    driven = add_joint_controllers(
        driven, controllers, report, has_free_wheels=order.kind == "none"
    )
    return msgspec.structs.replace(driven, report=(*driven.report, *report.entries()))


def parse_world(
    text: str, *, resolve: ResolveInclude, find_mesh: FindFile, allow_missing: bool = False
) -> WorldWithMeshes:
    """Parse a world and convert its meshes; models with unusable meshes are left out.

    Args:
        text: SDF with one <world>.
        resolve: Finds the text of an included model.
        find_mesh: Finds sha256 and bytes of a mesh, image or material file by its URI.
        allow_missing: Leave out missing included models.

    Raises:
        ModelError: The text is not a valid SDF world.
    """
    from zensim.sim_server.description.meshes.mesh_conversion import MeshConversions, convert_meshes
    from zensim.sim_server.description.sdf.sdf_world import read_world

    world = read_world(text, resolve=resolve, find_mesh=find_mesh, allow_missing=allow_missing)
    replace = msgspec.structs.replace
    conversions, models, report = MeshConversions(), [], list(world.report)
    unusable: list[str] = []
    for placed in world.models:
        try:
            model = convert_meshes(placed.model, find_mesh, conversions)
        except ModelError as error:
            report.append(ReportEntry("suspicious", f"model '{placed.name}'", f"left out: {error}"))
            unusable.append(str(error))
            continue
        new = model.report[len(placed.model.report) :]
        unusable += [entry.reason for entry in new if entry.status != "ignored"]
        model = _add_notes(complete_sensors(model, "fixed"), conversions.meshes)
        new = model.report[len(placed.model.report) :]
        report += [replace(entry, subject=f"{placed.name}: {entry.subject}") for entry in new]
        models.append(replace(placed, model=model))
    whole = replace(world, models=tuple(models), report=tuple(report))
    return WorldWithMeshes(whole, conversions.meshes, tuple(unusable))


def _add_notes(model: Model, meshes: dict[str, bytes]) -> Model:
    """Add what needs the meshes: moments, round wheels, how it will drive; and its joints."""
    if model.joints:
        from zensim.sim_server.description.joint_load_notes import describe_joint_loads

        report = (*model.report, *describe_joint_loads(model))
        model = msgspec.structs.replace(model, report=report)

    def corners(mesh: str) -> npt.NDArray[np.float32]:
        from zensim.proto.stl import read_corners

        return read_corners(meshes[mesh])

    contacts = [
        ReportEntry("applied", "drive" if model.drive else "wheels", note)
        for note in describe_contacts(model, corners)
    ]
    if model.drive is None:
        model = _raise_light_moments(model, corners)
        fall = (FALL,) if falls_without_end(model) else ()
        notes = [*contacts, *fall, *_describe_pairs(model)]
        return msgspec.structs.replace(model, report=(*model.report, *notes)) if notes else model
    from zensim.sim_server.description.driving_notes import describe_driving

    driving = describe_driving(model, corners)
    report = (*model.report, *contacts, *driving.entries)
    return msgspec.structs.replace(model, report=report, drags=driving.drags)


def _describe_pairs(model: Model) -> Iterator[ReportEntry]:
    """Say what PyBullet makes of the friction of a loose body; see `bullet.pair_friction`."""
    if model.is_static or len(model.links) > 1:
        return
    slippery = sorted({s.friction for s in model.links[0].collisions if 0.0 < s.friction < 1.0})
    for friction in slippery[:1]:
        note = (
            f"{friction:g} on a moving body of another friction f below 1 grips by the root of "
            f"{friction:g} f in PyBullet, not by the lesser"
        )
        yield ReportEntry("predicted", "friction", note)


def _raise_light_moments(model: Model, corners: FindCorners) -> Model:
    """Raise the moments of loose bodies, and of links without any: PyBullet diverges with less."""
    if model.is_static:
        return model
    raised, report, replace = list(model.links), list(model.report), msgspec.structs.replace
    for number, link in enumerate(model.links):
        is_light = len(model.links) == 1 or has_no_moments(link.inertial)
        if not (is_light and link.inertial.mass_kg and link.collisions):
            continue
        from zensim.sim_server.description.body_moments import describe_moments, raise_light_moments

        inertial = raise_light_moments(link, corners)
        if inertial is None:
            continue
        note = (
            f"it turns slower than described: moments {describe_moments(link.inertial.inertia)} "
            f"are too small for its collisions; {describe_moments(inertial.inertia)} are used"
        )
        report.append(ReportEntry("predicted", f"link {link.name!r}", note))
        raised[number] = replace(link, inertial=inertial)
    return replace(model, links=tuple(raised), report=tuple(report))


def _set_compat(model: Model, compat: Compat) -> Model:
    replace = msgspec.structs.replace
    return replace(
        model,
        drive=replace(model.drive, compat=compat) if model.drive else None,
        ground_truths=tuple(replace(truth, compat=compat) for truth in model.ground_truths),
    )


def warm_up() -> None:
    """Parse a sample of each format: the sandbox later prevents lazy imports."""
    import numpy as np
    import trimesh

    from zensim.sim_server.description.meshes.textures import warm_up_images
    from zensim.sim_server.description.sdf.sdf_includes import no_includes

    warm_up_images()
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    tetrahedron = trimesh.Trimesh(corners, sides)
    for ending in ("stl", "obj", "dae", "glb"):
        exported = tetrahedron.export(file_type=ending)
        data = exported.encode() if isinstance(exported, str) else exported
        assert isinstance(data, bytes)
        name = f"a.{ending}"
        for text in (SAMPLE_URDF, SAMPLE_SDF) if ending == "stl" else (SAMPLE_URDF,):
            parse_description(
                text.format(name), assets={name: ("", data)}, allow_missing=False, compat="fixed"
            )
    for text in ("", "<robot", SAMPLE_WITHOUT_DRIVE, read_builtin_model("box_bot")):
        with suppress(ModelError):
            parse_description(
                text, assets={}, allow_missing=False, compat="fixed", controllers=("a: b",)
            )
    parse_world(read_builtin_world("walls"), resolve=no_includes, find_mesh=lambda _: None)
