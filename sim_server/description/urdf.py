"""URDF text to Model: strict XML, then grammar, parts, tree, lumping, plug-ins, in this order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from proto.model import Model
from proto.result import SpawnCode
from sim_server.description.assets import HasMesh, no_meshes
from sim_server.description.gazebo import read_gazebo, with_surfaces
from sim_server.description.grammar import check_grammar
from sim_server.description.lumping import lump
from sim_server.description.parts import read_parts
from sim_server.description.plugins import read_plugins
from sim_server.description.report import Report
from sim_server.description.strict_xml import parse_xml
from sim_server.description.tree import in_tree_order
from sim_server.description.values import check_links, check_moving, with_unit_axes
from sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def read_urdf(text: str, *, has_mesh: HasMesh = no_meshes) -> Model:
    """Read a robot; what became of each tag that matters is in the model's report.

    Args:
        text: URDF, xacro already expanded.
        has_mesh: Whether a mesh URI is on the server; no file is opened here.

    Raises:
        ModelError: The text is no URDF, or describes what cannot be.
    """
    report = Report()
    robot = parse_xml(text, root_tag="robot", slug="urdf")
    _refuse_xacro(robot)
    check_grammar(robot, report)
    parts = in_tree_order(read_parts(robot, has_mesh=has_mesh, report=report))
    check_links(parts.links, report)
    blocks = read_gazebo(robot, parts, report)
    lumped = lump(
        with_surfaces(parts.links, blocks),
        with_unit_axes(parts.joints),
        kept=frozenset(blocks.kept_joints),
    )
    check_moving(lumped.links, lumped.joints, report)
    plugins = read_plugins(blocks.plugins, lumped, report)
    return Model(
        name=parts.name,
        links=lumped.links,
        joints=lumped.joints,
        frames=lumped.frames,
        drive=plugins.drive,
        joint_state=plugins.joint_state,
        is_static=blocks.is_static,
        report=report.entries(),
    )


def _refuse_xacro(robot: Element) -> None:
    for element in robot.iter():
        if "/xacro}" in element.tag:
            raise ModelError(
                f"the description has {element.tag.partition('}')[2][:80]!r} of xacro "
                f"at line {element.sourceline}; run xacro on it first",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="urdf.xacro",
            )
