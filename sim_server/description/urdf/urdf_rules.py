"""Elements and attributes of URDF, and of the extensions of Gazebo, that are read."""

from __future__ import annotations

import msgspec

from zensim.sim_server.description.element_rules import (
    ANY_TEXT,
    NAMED,
    ONE,
    OPAQUE,
    TEXT,
    ElementRule,
    NumberCounts,
    make_leaves,
    make_unread,
)
from zensim.sim_server.description.link_surfaces import (
    MATERIAL_RULE,
    SURFACE_RULE,
    SURFACE_TAG_NAMES,
)

THREE: NumberCounts = (3,)
SCALE: NumberCounts = (1, 3, 4)
"""Numbers of the scale of a mesh; RViz and PyBullet do not read the fourth."""
ORIGIN = ElementRule(attributes={"xyz": THREE, "rpy": THREE})
COLOUR = ElementRule(attributes={"rgba": (3, 4)})
TEXTURE = ElementRule(attributes={"filename": TEXT})
MATERIAL = ElementRule(
    attributes={"name": TEXT}, children={"color": COLOUR, "texture": TEXTURE}, can_be_left_out=True
)
GEOMETRY = ElementRule(
    is_choice=True,
    children={
        "box": ElementRule(attributes={"size": THREE}, required=("size",)),
        "sphere": ElementRule(attributes={"radius": ONE}, required=("radius",)),
        "cylinder": ElementRule(
            attributes={"radius": ONE, "length": ONE}, required=("radius", "length")
        ),
        "capsule": ElementRule(
            attributes={"radius": ONE, "length": ONE}, required=("radius", "length")
        ),
        "ellipsoid": ElementRule(attributes={"radii": THREE}, required=("radii",)),
        "cone": ElementRule(
            attributes={"radius": ONE, "length": ONE}, required=("radius", "length")
        ),
        "mesh": ElementRule(attributes={"filename": TEXT, "scale": SCALE}, required=("filename",)),
    },
)
_NOT_URDF = "not of URDF; no simulator reads it"
COLLISION = ElementRule(
    attributes={"name": TEXT},
    unused={"group": _NOT_URDF},
    children={
        "origin": ORIGIN,
        "geometry": GEOMETRY,
        "material": ElementRule(unread="collisions are not drawn"),
        "surface": ElementRule(unread="SDF only; set friction by <mu1> in <gazebo>"),
        "contact_coefficients": ElementRule(unread="set friction by <mu1> in <gazebo>"),
        "verbose": ElementRule(unread=_NOT_URDF),
    },
    needed=("geometry",),
)
VISUAL = msgspec.structs.replace(
    COLLISION, children={**COLLISION.children, "material": MATERIAL}, can_be_left_out=True
)
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
INERTIAL = ElementRule(
    children={
        "origin": ORIGIN,
        "mass": ElementRule(attributes={"value": ONE}, required=("value",)),
        "inertia": ElementRule(
            attributes=dict.fromkeys(MOMENTS, ONE), required=("ixx", "iyy", "izz")
        ),
    },
    needed=("mass",),
)
LINK = ElementRule(
    attributes={"name": TEXT},
    unused={"type": _NOT_URDF},
    required=("name",),
    children={
        "inertial": INERTIAL,
        "visual": VISUAL,
        "collision": COLLISION,
        "contact": ElementRule(unread="Bullet only; set friction by <mu1> in <gazebo>"),
        "self_filter": ElementRule(unread="for filters of point clouds only"),
        "self_collision_checking": ElementRule(unread="for motion planners only"),
    },
    many=("visual", "collision"),
)
JOINT_END = ElementRule(attributes={"link": TEXT}, required=("link",))
JOINT = ElementRule(
    attributes={"name": TEXT, "type": TEXT},
    required=("name", "type"),
    children={
        "origin": ORIGIN,
        "parent": JOINT_END,
        "child": JOINT_END,
        "axis": ElementRule(
            attributes={"xyz": THREE}, unused={"rpy": "the axis is a direction in the joint frame"}
        ),
        "limit": ElementRule(
            attributes=dict.fromkeys(("lower", "upper", "effort", "velocity"), ONE)
        ),
        "dynamics": ElementRule(
            attributes={"damping": ONE, "friction": ONE},
            unused=dict.fromkeys(("D", "K", "mu_coulomb", "mu_viscous"), _NOT_URDF)
            | dict.fromkeys(
                ("spring_reference", "spring_stiffness"), "write <springStiffness> in <gazebo>"
            ),
        ),
        "joint_properties": ElementRule(unread="of 2009; write <dynamics>"),
        "mimic": ElementRule(
            attributes={"joint": TEXT, "multiplier": ONE, "offset": ONE}, required=("joint",)
        ),
        "calibration": ElementRule(
            attributes=dict.fromkeys(("rising", "falling", "reference_position"), ONE),
            unread="real encoders only",
        ),
        "safety_controller": ElementRule(
            attributes=dict.fromkeys(
                ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), ONE
            ),
            unread="real controllers only",
        ),
    },
    needed=("parent", "child"),
)
_DIRECT = "not simulated: joints are moved directly"
_SIMPLE = ("transmission_interface/simpletransmission", "simpletransmission")
_REDUCTION = make_unread(_DIRECT, "mechanicalReduction", idle=("1", "1.0"))
TRANSMISSION = ElementRule(
    attributes=NAMED,
    unused={"type": _DIRECT},
    children={
        "type": ElementRule(unread=_DIRECT, idle=_SIMPLE),
        "joint": ElementRule(
            attributes=NAMED, children=make_leaves("hardwareInterface") | _REDUCTION, others=_DIRECT
        ),
        "actuator": ElementRule(
            attributes=NAMED, children=make_leaves("hardwareInterface") | _REDUCTION, others=_DIRECT
        ),
        **_REDUCTION,
    },
    many=("joint", "actuator"),
    others=_DIRECT,
)
_INTERFACE = ElementRule(
    attributes=NAMED, children={"param": ElementRule(attributes=NAMED)}, many=("param",)
)
ROS2_CONTROL = ElementRule(
    attributes=NAMED | {"type": ANY_TEXT},
    unused=dict.fromkeys(
        ("rw_rate", "is_async", "thread_priority"), "commands act at each state of the robot"
    ),
    children={
        "joint": ElementRule(
            attributes=NAMED,
            unused={"mimic": "write <mimic> in the <joint> of URDF"},
            children={
                "command_interface": _INTERFACE,
                "state_interface": _INTERFACE,
                **make_unread("the limits of URDF are used", "limits"),
                **make_unread("only those of interfaces are read", "param"),
            },
            many=("command_interface", "state_interface"),
        ),
        **make_unread("the server moves the joints, without a plug-in", "hardware"),
        **make_unread("sensors are read from <gazebo>", "sensor"),
        **make_unread("not simulated", "gpio"),
        **make_unread(_DIRECT, "transmission"),
    },
    many=("joint",),
)
ROBOT = ElementRule(
    attributes={"name": TEXT, "version": TEXT},
    required=("name",),
    children={
        "link": LINK,
        "joint": JOINT,
        "material": msgspec.structs.replace(MATERIAL, required=("name",)),
        "gazebo": OPAQUE,
        "transmission": TRANSMISSION,
        "ros2_control": ROS2_CONTROL,
        "sensor": ElementRule(unread="no simulator reads it outside <gazebo>"),
    },
    many=("link", "joint", "material", "gazebo", "transmission", "ros2_control", "sensor"),
    is_top=True,
)
_NO_EFFECT = "Gazebo tag without effect"
KEEP_JOINT_TAGS = ("preserveFixedJoint", "disableFixedJointLumping")
SPRING_TAGS = ("springStiffness", "springReference")
_VALUE = ElementRule(attributes={"value": ANY_TEXT})


def _make_block(children: dict[str, ElementRule]) -> ElementRule:
    """Make the rule of a <gazebo>, whose last of equal tags is used."""
    return ElementRule(attributes={"reference": ANY_TEXT}, children=children, many=tuple(children))


GAZEBO_OF_MODEL = _make_block(
    {
        "plugin": OPAQUE,
        **dict.fromkeys(("static", "self_collide"), _VALUE),
        **make_unread(_NO_EFFECT, "allow_auto_disable", "canonicalBody", "verbose", "enable_wind"),
        **make_unread("joints are read outside of <gazebo>", "joint"),
        **make_unread("links are read outside of <gazebo>", "link"),
        **make_unread("the pose is set by the spawn request", "pose"),
    }
)
GAZEBO_OF_LINK = _make_block(
    {
        **dict.fromkeys((*SURFACE_TAG_NAMES, "material"), _VALUE),
        "collision": ElementRule(
            attributes=NAMED,
            children={"surface": SURFACE_RULE},
            others="only a <surface> is used",
        ),
        "visual": ElementRule(
            attributes=NAMED,
            children={"material": MATERIAL_RULE},
            others="only the colour of its <material> is used",
        ),
        **dict.fromkeys(("plugin", "sensor"), OPAQUE),
        **make_unread(
            _NO_EFFECT,
            "canonicalBody", "clearMaterial", "enable_wind", "genTexCoord", "kinematic",
            "laserRetro", "maxContacts", "max_contacts", "must_be_base_link", "projector",
        ),
        **make_unread("sound is not simulated", "audio_source"),
        **make_unread("lights of robots are not drawn", "light"),
        **make_unread("particles are not simulated", "particle_emitter"),
        **make_unread("write <dampingFactor>", "velocity_decay"),
    }
)  # fmt: skip
GAZEBO_OF_JOINT = _make_block(
    {
        **dict.fromkeys((*KEEP_JOINT_TAGS, *SPRING_TAGS), _VALUE),
        **make_unread(
            _NO_EFFECT,
            "cfmDamping", "dampingFactor", "erp", "fudgeFactor", "initial_joint_position",
            "provideFeedback", "stopCfm", "stopErp",
        ),
        **make_unread(
            "the engine chooses how it integrates springs", "implicitSpringDamper"
        ),
    }
)  # fmt: skip
