"""URDF text to Model: strict XML, then grammar, parts, tree, lumping, plug-ins, in this order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import Joint, Model
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.assets import HasMesh, no_meshes
from zensim.sim_server.description.following import with_true_mimics
from zensim.sim_server.description.free_joints import with_chains
from zensim.sim_server.description.gazebo import GazeboBlocks, read_gazebo, with_surfaces
from zensim.sim_server.description.grammar import check_grammar
from zensim.sim_server.description.lumping import Lumped, lump
from zensim.sim_server.description.parts import read_parts
from zensim.sim_server.description.plugins import read_plugins
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.sensors import read_sensors
from zensim.sim_server.description.shapes import MeshRule
from zensim.sim_server.description.strict_xml import parse_xml
from zensim.sim_server.description.tree import in_tree_order, is_held_by_world, without_world
from zensim.sim_server.description.values import check_links, check_moving, with_unit_axes
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.part_list import Parts

MAX_JOINTS = 120
"""Left after lumping: the engine reads the states of 127 joints of a body and no more."""
OPAQUE = ("gazebo", "transmission", "ros2_control")
"""Tags whose contents others may expand later."""


def read_urdf(text: str, *, has_mesh: HasMesh = no_meshes, allow_missing: bool = False) -> Model:
    """Read a robot; what became of each tag that matters is in the model's report.

    Args:
        text: URDF, xacro already expanded.
        has_mesh: Whether a mesh URI is on the server; no file is opened here.
        allow_missing: Leave collisions out whose mesh is not on the server.

    Raises:
        ModelError: The text is no URDF, or describes what cannot be.
    """
    report = Report()
    robot = parse_xml(text, root_tag="robot", slug="urdf")
    _refuse_xacro(robot)
    check_grammar(robot, report)
    parts = in_tree_order(read_parts(robot, MeshRule(has_mesh, allow_missing), report))
    parts = without_world(parts, report)
    check_links(parts.links, report)
    blocks = read_gazebo(robot, parts, report)
    lumped = _lumped(parts, blocks, report)
    plugins = read_plugins(blocks.plugins, lumped, report)
    return Model(
        name=parts.name,
        links=lumped.links,
        joints=lumped.joints,
        frames=lumped.frames,
        drive=plugins.drive,
        joint_state=plugins.joint_state,
        ground_truths=plugins.ground_truths,
        sensors=read_sensors(blocks.sensors, lumped, report),
        is_static=blocks.is_static or is_held_by_world(parts, report),
        report=report.entries(),
    )


def _lumped(parts: Parts, blocks: GazeboBlocks, report: Report) -> Lumped:
    lumped = lump(
        with_surfaces(parts.links, blocks),
        _fixed(parts.joints) if blocks.is_static else with_unit_axes(parts.joints),
        kept=frozenset(blocks.kept_joints),
    )
    check_moving(lumped.links, lumped.joints, report)
    joints = with_true_mimics(lumped.joints, report)
    lumped = with_chains(Lumped(lumped.links, joints, lumped.frames), report)
    if len(lumped.joints) > MAX_JOINTS:
        raise ModelError(
            f"{len(lumped.joints)} joints are left once fixed ones are merged; "
            f"at most {MAX_JOINTS} are simulated",
            slug="urdf.joints",
        )
    return lumped


def _fixed(joints: tuple[Joint, ...]) -> tuple[Joint, ...]:
    return tuple(
        msgspec.structs.replace(joint, kind="fixed", mimic=None) for joint in with_unit_axes(joints)
    )


def _refuse_xacro(robot: Element) -> None:
    for element in robot.iter():
        if "/xacro}" in element.tag or element.tag.startswith("xacro:"):
            raise _unexpanded(element, element.tag.rpartition("}")[2])
    for part in robot:
        for element in () if part.tag in OPAQUE else part.iter():
            for value in element.attrib.values():
                if "${" in value or "$(" in value:
                    raise _unexpanded(element, value)


def _unexpanded(element: Element, what: str) -> ModelError:
    return ModelError(
        f"the description has {shown(what)} of xacro at line {element.sourceline}; "
        "run xacro on it first",
        code=SpawnCode.UNSUPPORTED_FORMAT,
        slug="urdf.xacro",
    )
