"""Elements of SDF models, and which of them have no effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

NO_EFFECT = "Gazebo tag without effect"
NOT_DRAWN = "the page draws plain colours"


class SdfElementRule(msgspec.Struct, frozen=True):
    """Children of one element."""

    children: dict[str, SdfElementRule] = {}
    many: tuple[str, ...] = ()
    """Children that may be repeated."""
    unread: str = ""
    """Reason why the element has no effect; empty when it has one."""
    is_opaque: bool = False
    """Its contents are not checked here."""


LEAF = SdfElementRule()
ZENSIM_MODEL_TAGS = ("{urn:zensim}dynamics", "zensim:dynamics")
OPAQUE = SdfElementRule(is_opaque=True)
UNUSED = SdfElementRule(unread=NO_EFFECT, is_opaque=True)
PLAIN = SdfElementRule(unread=NOT_DRAWN, is_opaque=True)
MATERIAL = SdfElementRule(
    children={
        "script": OPAQUE,
        "ambient": LEAF,
        "diffuse": LEAF,
        **dict.fromkeys(
            (
                "specular", "emissive", "lighting", "shader", "pbr", "render_order",
                "double_sided", "shininess",
            ),
            PLAIN,
        ),
    }
)  # fmt: skip
COLLISION = SdfElementRule(
    children={
        "pose": LEAF,
        "geometry": OPAQUE,
        "surface": OPAQUE,
        "laser_retro": UNUSED,
        "max_contacts": UNUSED,
        "density": UNUSED,
        "frame": UNUSED,
    }
)
VISUAL = SdfElementRule(
    children={
        "pose": LEAF,
        "geometry": OPAQUE,
        "material": MATERIAL,
        "transparency": LEAF,
        "cast_shadows": PLAIN,
        "laser_retro": UNUSED,
        "meta": PLAIN,
        "plugin": UNUSED,
        "visibility_flags": PLAIN,
        "frame": UNUSED,
    }
)
INERTIAL = SdfElementRule(
    children={
        "pose": LEAF,
        "mass": LEAF,
        "inertia": SdfElementRule(
            children=dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), LEAF)
        ),
        "fluid_added_mass": UNUSED,
        "density": UNUSED,
        "frame": UNUSED,
    }
)
LINK = SdfElementRule(
    children={
        "pose": LEAF,
        "inertial": INERTIAL,
        "collision": COLLISION,
        "visual": VISUAL,
        "sensor": OPAQUE,
        **dict.fromkeys(
            (
                "audio_sink", "audio_source", "battery", "enable_wind", "frame", "kinematic",
                "light", "must_be_base_link", "particle_emitter", "plugin", "projector",
            ),
            UNUSED,
        ),
        **dict.fromkeys(("gravity", "self_collide"), LEAF),
        "velocity_decay": SdfElementRule(children=dict.fromkeys(("linear", "angular"), LEAF)),
    },
    many=("collision", "visual", "sensor", "light", "plugin", "battery"),
)  # fmt: skip
AXIS = SdfElementRule(
    children={
        "xyz": LEAF,
        "use_parent_model_frame": LEAF,
        "initial_position": UNUSED,
        "mimic": OPAQUE,
        "limit": SdfElementRule(
            children={
                **dict.fromkeys(("lower", "upper", "effort", "velocity"), LEAF),
                "stiffness": UNUSED,
                "dissipation": UNUSED,
            }
        ),
        "dynamics": SdfElementRule(
            children={
                "damping": LEAF,
                "friction": LEAF,
                "spring_reference": UNUSED,
                "spring_stiffness": UNUSED,
            }
        ),
    }
)
JOINT = SdfElementRule(
    children={
        **dict.fromkeys(("pose", "parent", "child"), LEAF),
        "axis": AXIS,
        "axis2": AXIS,
        "sensor": OPAQUE,
        **dict.fromkeys(
            (
                "frame", "gearbox_ratio", "gearbox_reference_body", "physics", "plugin",
                "screw_thread_pitch", "thread_pitch",
            ),
            UNUSED,
        ),
    },
    many=("sensor", "plugin"),
)  # fmt: skip
MODEL = SdfElementRule(
    children={
        **dict.fromkeys(("pose", "static", "frame", "self_collide", *ZENSIM_MODEL_TAGS), LEAF),
        "link": LINK,
        "joint": JOINT,
        "model": OPAQUE,
        "plugin": OPAQUE,
        **dict.fromkeys(
            ("allow_auto_disable", "enable_wind", "gripper", "static_origin"),
            UNUSED,
        ),
    },
    many=("frame", "link", "joint", "model", "plugin", "gripper"),
)


def report_unused_tags(model: Element, scope: str, report: ParseReport) -> None:
    """Report the tags of a <model> that have no effect, without nested models."""
    _report_element(model, MODEL, f"model {scope!r}" if scope else "model", report)


def _report_element(element: Element, tag: SdfElementRule, where: str, report: ParseReport) -> None:
    if tag.unread:
        report.ignored(where, tag.unread)
    if tag.is_opaque:
        return
    seen: set[str] = set()
    for child in element:
        if child.tag not in tag.children:
            report.unread_tag(where, child.tag, tag.children)
            continue
        below = _describe_place(where, child)
        if child.tag in seen and child.tag not in tag.many:
            report.suspicious(below, "given more than once; the first is used")
        elif tag.children[child.tag] is not LEAF:
            _report_element(child, tag.children[child.tag], below, report)
        seen.add(child.tag)


def _describe_place(where: str, child: Element) -> str:
    name = child.get("name")
    if name and where.startswith("model"):
        return f"{child.tag} {name[:80]!r}"
    return f"{where}: <{child.tag}>" if ": <" not in where else f"{where[:-1]}/{child.tag}>"
