"""Elements and attributes of SDF that are read: models, worlds, includes, lights."""

from __future__ import annotations

from zensim.sim_server.description.element_rules import (
    ANY_TEXT,
    LEAF,
    NAMED,
    OPAQUE,
    POSE,
    ElementRule,
    make_leaves,
    make_unread,
)
from zensim.sim_server.description.link_surfaces import MATERIAL_RULE, SURFACE_RULE

VERSION_ATTRIBUTE = "sdf_version"
"""Set on each model and world, since a model may include models of other versions."""
_NO_EFFECT = "Gazebo tag without effect"
_NOT_DRAWN = "the page draws diffuse colours and textures"
_NO_AIR = "air is not simulated"
MOMENT_TAGS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_MESH = ElementRule(
    unused=dict.fromkeys(
        ("optimization", "simplification"), "collisions are convex hulls of whole meshes"
    ),
    children=make_leaves("uri", "scale")
    | make_unread("collisions are convex hulls of whole meshes", "convex_decomposition")
    | {"submesh": OPAQUE},
)
GEOMETRY = ElementRule(
    children={
        "box": ElementRule(children=make_leaves("size")),
        "sphere": ElementRule(children=make_leaves("radius")),
        **dict.fromkeys(
            ("cylinder", "capsule", "cone"), ElementRule(children=make_leaves("radius", "length"))
        ),
        "ellipsoid": ElementRule(children=make_leaves("radii")),
        "plane": ElementRule(children=make_leaves("normal", "size")),
        "mesh": _MESH,
        "polyline": ElementRule(children=make_leaves("point", "height"), many=("point",)),
        "empty": LEAF,
        **dict.fromkeys(("heightmap", "image"), OPAQUE),
    },
    many=("polyline",),
)
COLLISION = ElementRule(
    attributes=NAMED,
    children={
        "pose": POSE,
        "geometry": GEOMETRY,
        "surface": SURFACE_RULE,
        **make_unread(_NO_EFFECT, "laser_retro", idle=("0", "0.0")),
        **make_leaves("density"),
        **make_unread(_NO_EFFECT, "max_contacts", "auto_inertia_params", "frame"),
    },
)
VISUAL = ElementRule(
    attributes=NAMED,
    children={
        "pose": POSE,
        "geometry": GEOMETRY,
        "material": MATERIAL_RULE,
        "transparency": LEAF,
        **make_unread(_NOT_DRAWN, "cast_shadows", "meta", "visibility_flags"),
        **make_unread(_NO_EFFECT, "laser_retro", "plugin", "frame"),
    },
)
INERTIAL = ElementRule(
    attributes={"auto": ANY_TEXT},
    children={
        "pose": POSE,
        **make_leaves("mass", "density"),
        "inertia": ElementRule(children=make_leaves(*MOMENT_TAGS)),
        **make_unread(_NO_EFFECT, "fluid_added_mass", "auto_inertia_params", "frame"),
    },
)
LIGHT = ElementRule(
    attributes=NAMED | {"type": ANY_TEXT},
    children={
        "pose": POSE,
        **make_leaves("diffuse", "intensity", "direction", "light_on", "cast_shadows"),
        "attenuation": ElementRule(
            children=make_leaves("range", "constant", "linear", "quadratic")
        ),
        "spot": ElementRule(
            children=make_leaves("outer_angle")
            | make_unread("a spot is equally bright up to <outer_angle>", "inner_angle", "falloff")
        ),
        **make_unread(_NOT_DRAWN, "specular"),
        **make_unread(_NO_EFFECT, "visualize", "frame"),
    },
)
LINK = ElementRule(
    attributes=NAMED,
    children={
        "pose": POSE,
        "inertial": INERTIAL,
        "collision": COLLISION,
        "visual": VISUAL,
        "sensor": OPAQUE,
        "light": LIGHT,
        **make_leaves("gravity", "self_collide"),
        "velocity_decay": ElementRule(children=make_leaves("linear", "angular")),
        **make_unread(
            _NO_EFFECT,
            "audio_sink", "audio_source", "battery", "enable_wind", "frame", "kinematic",
            "must_be_base_link", "particle_emitter", "plugin", "projector",
        ),
    },
    many=("collision", "visual", "sensor", "light"),
)  # fmt: skip
AXIS = ElementRule(
    children={
        "xyz": ElementRule(attributes={"expressed_in": ANY_TEXT}),
        "use_parent_model_frame": LEAF,
        "mimic": ElementRule(
            attributes={"joint": ANY_TEXT},
            unused={"axis": "the leader's last axis is followed"},
            children=make_leaves("joint", "multiplier", "reference", "offset"),
        ),
        "limit": ElementRule(
            children=make_leaves("lower", "upper", "effort", "velocity")
            | make_unread(_NO_EFFECT, "stiffness", "dissipation")
        ),
        "dynamics": ElementRule(
            children=make_leaves("damping", "friction", "spring_reference", "spring_stiffness")
        ),
        **make_unread(_NO_EFFECT, "initial_position"),
    }
)
JOINT = ElementRule(
    attributes=NAMED | {"type": ANY_TEXT},
    children={
        "pose": POSE,
        **make_leaves("parent", "child"),
        "axis": AXIS,
        "axis2": AXIS,
        **make_unread("sensors of joints are not simulated", "sensor"),
        **make_unread(
            _NO_EFFECT,
            "frame", "gearbox_ratio", "gearbox_reference_body", "physics", "plugin",
            "screw_thread_pitch", "thread_pitch",
        ),
    },
)  # fmt: skip
FRAME = ElementRule(
    attributes=NAMED | dict.fromkeys(("attached_to", "placement_frame"), ANY_TEXT),
    children={"pose": POSE},
)
_MODEL_ATTRIBUTES = NAMED | dict.fromkeys(
    ("canonical_link", "placement_frame", VERSION_ATTRIBUTE), ANY_TEXT
)
MODEL = ElementRule(
    attributes=_MODEL_ATTRIBUTES,
    children={
        "pose": POSE,
        **make_leaves("static", "self_collide", "zensim:dynamics"),
        "frame": FRAME,
        "link": LINK,
        "joint": JOINT,
        "model": OPAQUE,
        "plugin": OPAQUE,
        **make_unread(_NO_EFFECT, "allow_auto_disable", "enable_wind", "gripper", "static_origin"),
    },
    many=("frame", "link", "joint", "model", "plugin"),
    is_top=True,
)
MERGED_TAGS = ("link", "model", "joint", "frame", "gripper", "plugin", "zensim:dynamics")
MERGED_MODEL = ElementRule(
    attributes=_MODEL_ATTRIBUTES,
    children=dict.fromkeys((*MERGED_TAGS, "pose"), OPAQUE),
    many=MERGED_TAGS,
    others="the owner of a merged model has its own",
)
"""An included model whose elements become those of its owner."""
INCLUDE = ElementRule(
    attributes={"merge": ANY_TEXT},
    children={
        **make_leaves("uri", "name", "static", "placement_frame"),
        "pose": POSE,
        "plugin": OPAQUE,
    },
    many=("plugin",),
)
_BUILT_IN = "a built-in model cannot be changed"
SUN_INCLUDE = ElementRule(
    unused={"merge": _BUILT_IN}, children=make_leaves("uri", "name"), others=_BUILT_IN
)
GROUND_INCLUDE = ElementRule(
    unused={"merge": _BUILT_IN},
    children=make_leaves("uri", "name", "static") | {"pose": POSE},
    others=_BUILT_IN,
)
SDF = ElementRule(
    attributes={"version": ANY_TEXT},
    children=dict.fromkeys(("world", "model", "light", "actor"), OPAQUE),
    many=("world", "model", "light", "actor"),
)
PHYSICS = ElementRule(
    attributes=NAMED | {"default": ANY_TEXT},
    unused={"type": "the engine is that of --engine"},
    children=make_leaves("max_step_size", "real_time_factor", "real_time_update_rate"),
    others="other engines only",
)
SCENE = ElementRule(
    children=make_leaves("ambient", "background"), others="the page draws colours and lights only"
)
SPHERICAL_CHOICES = {"surface_model": "EARTH_WGS84", "world_frame_orientation": "ENU"}
"""Tags of <spherical_coordinates> with one supported value."""
SPHERICAL_LIMITS = {
    "latitude_deg": 90.0,
    "longitude_deg": 360.0,
    "elevation": 100_000.0,
    "heading_deg": 360.0,
}
"""Largest values [deg, m], in the order of `SphericalCoordinates`."""
WORLD_FRAME = ElementRule(
    attributes=NAMED | {"attached_to": ANY_TEXT},
    children={"pose": POSE, **make_leaves("zensim:description", "zensim:tags", "zensim:size")},
)
POPULATION = ElementRule(
    attributes=NAMED,
    children={
        "pose": ElementRule(
            attributes=dict.fromkeys(("degrees", "rotation_format"), ANY_TEXT),
            unused=dict.fromkeys(("relative_to", "frame"), "the pose is in the world"),
        ),
        **dict.fromkeys(("model", "include"), OPAQUE),
        "box": ElementRule(children=make_leaves("size")),
        "cylinder": ElementRule(children=make_leaves("radius", "length")),
        "model_count": LEAF,
        "distribution": ElementRule(children=make_leaves("type", "rows", "cols", "step")),
        **make_unread(_NO_EFFECT, "frame"),
    },
)
STATE = ElementRule(
    attributes={"world_name": ANY_TEXT},
    children={
        "model": ElementRule(
            attributes=NAMED | {VERSION_ATTRIBUTE: ANY_TEXT},
            children={"pose": POSE},
            others="only poses of models are used",
        )
    },
    many=("model",),
    others="only poses of models are used",
)
UNSUPPORTED_WORLD_TAGS = {
    "actor": "actors are not simulated",
    "joint": "joints between models are not simulated",
    "road": "roads are not simulated",
}
"""Robots may collide with what is left out."""
WORLD = ElementRule(
    attributes=NAMED | {VERSION_ATTRIBUTE: ANY_TEXT},
    children={
        **make_leaves("gravity", "magnetic_field", "zensim:description", "zensim:tags"),
        **dict.fromkeys(("model", *UNSUPPORTED_WORLD_TAGS), OPAQUE),
        "physics": PHYSICS,
        "scene": SCENE,
        "light": LIGHT,
        "frame": WORLD_FRAME,
        "state": STATE,
        "spherical_coordinates": ElementRule(
            children=make_leaves(*SPHERICAL_CHOICES, *SPHERICAL_LIMITS)
        ),
        **make_unread(_NO_AIR, "atmosphere", "wind"),
        **make_unread("sound is not simulated", "audio"),
        **make_unread("the page has its own view", "gui"),
        **make_unread("world plug-ins are not loaded; services are built in", "plugin"),
    },
    many=("model", "light", "frame", "state", *UNSUPPORTED_WORLD_TAGS),
    is_top=True,
)
"""Rule of <world> after the expansion of populations and includes."""
