"""Surfaces of links: friction, contact, gravity, velocity decay and colour."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import (
    ZERO,
    Contact,
    Decay,
    Inertial,
    Quat,
    Shape,
    Texture,
    Vec3,
)
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.element_rules import (
    ElementRule,
    make_leaves,
    make_tree,
    make_unread,
)
from zensim.sim_server.description.strict_parsing import parse_flag, quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link
    from zensim.sim_server.description.report import ParseReport

GAZEBO_COLOURS: dict[str, Quat] = {
    "Black": (0.0, 0.0, 0.0, 1.0),
    "Blue": (0.0, 0.0, 1.0, 1.0),
    "BlueGlow": (0.0, 0.0, 1.0, 1.0),
    "BlueTransparent": (0.0, 0.0, 1.0, 0.5),
    "DarkGrey": (0.175, 0.175, 0.175, 1.0),
    "DarkYellow": (0.7, 0.7, 0.0, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
    "Gray": (0.7, 0.7, 0.7, 1.0),
    "Green": (0.0, 1.0, 0.0, 1.0),
    "GreenGlow": (0.0, 1.0, 0.0, 1.0),
    "GreenTransparent": (0.0, 1.0, 0.0, 0.5),
    "Grey": (0.7, 0.7, 0.7, 1.0),
    "Indigo": (0.33, 0.0, 0.5, 1.0),
    "Purple": (1.0, 0.0, 1.0, 1.0),
    "Red": (1.0, 0.0, 0.0, 1.0),
    "RedBright": (0.87, 0.26, 0.07, 1.0),
    "RedGlow": (1.0, 0.0, 0.0, 1.0),
    "RedTransparent": (1.0, 0.0, 0.0, 0.5),
    "SkyBlue": (0.13, 0.44, 0.7, 1.0),
    "Turquoise": (0.0, 1.0, 1.0, 1.0),
    "White": (1.0, 1.0, 1.0, 1.0),
    "WhiteGlow": (1.0, 1.0, 1.0, 1.0),
    "Wood": (0.6, 0.42, 0.22, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0),
    "YellowGlow": (1.0, 1.0, 0.0, 1.0),
    "Gold": (0.8, 0.649, 0.121, 1.0),
    "Orange": (1.0, 0.509, 0.047, 1.0),
    "ZincYellow": (0.973, 0.953, 0.208, 1.0),
    "PurpleGlow": (1.0, 0.0, 1.0, 1.0),
    "TurquoiseGlow": (0.0, 1.0, 1.0, 1.0),
    "TurquoiseGlowOutline": (0.0, 1.0, 1.0, 1.0),
    "RedTransparentOverlay": (1.0, 0.0, 0.0, 0.5),
    "GreenTransparentOverlay": (0.0, 1.0, 0.0, 0.5),
    "BlueTransparentOverlay": (0.0, 0.0, 1.0, 0.5),
    "GreyTransparent": (0.5, 0.5, 0.5, 0.5),
    "YellowTransparent": (1.0, 1.0, 0.0, 0.5),
    "OrangeTransparent": (1.0, 0.44, 0.0, 0.4),
    "BlueLaser": (0.0, 0.0, 1.0, 0.4),
    "LightOn": (0.0, 1.0, 0.0, 1.0),
    "LightOff": (1.0, 0.0, 0.0, 1.0),
    "PioneerBody": (1.0, 0.0, 0.0, 1.0),
    "Pioneer2Body": (0.681, 0.001, 0.001, 1.0),
    "JointAnchor": (1.0, 1.0, 1.0, 1.0),
    "WoodFloor": (0.6, 0.42, 0.22, 1.0),
    "WoodPallet": (0.6, 0.42, 0.22, 1.0),
    "Bricks": (0.6, 0.33, 0.25, 1.0),
    "CeilingTiled": (0.85, 0.85, 0.85, 1.0),
    "PaintedWall": (0.85, 0.82, 0.75, 1.0),
    "WindowFrame": (0.8, 0.8, 0.8, 1.0),
    "Pedestrian": (0.6, 0.6, 0.6, 1.0),
    "Footway": (0.6, 0.6, 0.6, 1.0),
    "Road": (0.35, 0.35, 0.35, 1.0),
    "Residential": (0.35, 0.35, 0.35, 1.0),
    "Tertiary": (0.35, 0.35, 0.35, 1.0),
    "Motorway": (0.35, 0.35, 0.35, 1.0),
    "Lanes_6": (0.35, 0.35, 0.35, 1.0),
    "Primary": (0.35, 0.35, 0.35, 1.0),
    "Secondary": (0.35, 0.35, 0.35, 1.0),
    "Lanes_4": (0.35, 0.35, 0.35, 1.0),
    "Lanes_2": (0.35, 0.35, 0.35, 1.0),
    "Trunk": (0.35, 0.35, 0.35, 1.0),
}
"""Colours of materials `Gazebo/<name>`, diffuse; the last lines estimate the mean of a texture.

Source: media/materials/scripts/gazebo.material of Gazebo Classic 11. SkyBlue is its ambient colour.
"""

RGB_COUNT = 3
_NOT_DRAWN = "the page draws diffuse colours and textures"
_WORKFLOW = ElementRule(
    children=make_leaves("albedo_map")
    | make_unread(
        _NOT_DRAWN,
        "ambient_occlusion_map", "emissive_map", "environment_map", "glossiness", "glossiness_map",
        "light_map", "metalness", "metalness_map", "normal_map", "roughness", "roughness_map",
        "specular_map",
    ),
)  # fmt: skip
MATERIAL_RULE = ElementRule(
    children=make_leaves("ambient", "diffuse")
    | make_unread(
        _NOT_DRAWN,
        "specular", "emissive", "lighting", "shader", "render_order", "double_sided", "shininess",
    )
    | {
        "script": ElementRule(children=make_leaves("uri", "name"), many=("uri",)),
        "pbr": ElementRule(children={"metal": _WORKFLOW, "specular": _WORKFLOW}),
    }
)  # fmt: skip
"""A <material> of SDF."""


def find_gazebo_colour(name: str) -> Quat | None:
    """Find the colour (r, g, b, a) of Gazebo's material `Gazebo/<name>`."""
    return GAZEBO_COLOURS.get(name.strip().removeprefix("Gazebo/"))


def read_gazebo_material(
    material: Element, *, where: str, slug: str, report: ParseReport
) -> Quat | None:
    """Find the colour of a <material> of SDF: of a known script, else diffuse or ambient.

    Raises:
        ModelError: A colour is not three or four numbers.
    """
    script = (material.findtext("script/name") or material.findtext("script") or "").strip()
    if script and (colour := find_gazebo_colour(script)) is not None:
        return colour
    for tag in ("diffuse", "ambient"):
        if text := (material.findtext(tag) or "").strip():
            return read_rgba(text, where=f"{where}, {tag}", slug=slug, report=report)
    if script:
        report.unknown(f"{where}: <script>", f"no colour is named {quote(script)}")
    return None


def read_rgba(text: str, *, where: str, slug: str, report: ParseReport | None) -> Quat:
    """Read three or four numbers as a colour, clamped to 0 to 1; clamping is reported.

    Raises:
        ModelError: They are not.
    """
    written = read_numbers(text, counts=(3, 4), where=where, slug=slug)
    if len(written) == RGB_COUNT:
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    if report is not None and (r, g, b, a) != written:
        report.suspicious(where, "colour out of the range 0 to 1; clamped")
    return (r, g, b, a)


class UrdfMaterial(msgspec.Struct, frozen=True):
    """Colour and image of a URDF <material>; None: not set."""

    rgba: Quat | None = None
    texture: Texture | None = None


def read_named_materials(robot: Element, report: ParseReport) -> dict[str, UrdfMaterial]:
    """Find the URDF materials that are defined; those of the robot override those of visuals."""
    looks: dict[str, UrdfMaterial] = {}
    for path in ("material", "link/visual/material"):
        for material in robot.findall(path):
            look, name = _read_urdf_material(material, report), material.get("name")
            if look != UrdfMaterial() and name:
                looks.setdefault(name, look)
    return looks


def read_visual_look(
    visual: Element, looks: dict[str, UrdfMaterial], report: ParseReport
) -> UrdfMaterial:
    """Find the material of a visual: its own, else the one with its name."""
    material = visual.find("material")
    if material is None:
        return UrdfMaterial()
    name = material.get("name") or ""
    look = _read_urdf_material(material, report)
    if look != UrdfMaterial():
        return look
    if name not in looks:
        report.suspicious(f"material {quote(name)}", "no <material> with this name has a colour")
    return looks.get(name, UrdfMaterial())


def _read_urdf_material(material: Element, report: ParseReport) -> UrdfMaterial:
    colour, texture = material.find("color"), material.find("texture")
    name = material.get("name") or ""
    image = (texture.get("filename") or "").strip() if texture is not None else ""
    return UrdfMaterial(
        _read_material_colour(colour, name, report) if colour is not None else None,
        Texture(image) if image else None,
    )


def _read_material_colour(colour: Element, name: str, report: ParseReport) -> Quat:
    where, text = f"material {quote(name)}", colour.get("rgba") or "1 1 1 1"
    if len(text.split()) == RGB_COUNT:
        report.suspicious(where, "its colour has three numbers; opaque")
    return read_rgba(text, where=where, slug="urdf.number", report=report)


DEFAULT_FRICTION = 1.0
"""Coulomb coefficient, as in Gazebo."""
INFINITE_FRICTION = 1e6
"""Coefficient of `Inf`, ODE's friction without a limit."""
INFINITY_TEXTS = ("inf", "+inf", "infinity", "+infinity")
DEFAULT_CONTACT_DAMPING = 1.0
"""[N s/m], as in Gazebo."""
RIGID_STIFFNESS = 1e9
"""Contact stiffness [N/m] from which a contact is rigid."""
MAX_RIGID_TIME_S = 0.01
"""Maximum damping over stiffness of a rigid contact."""
MAX_CONTACT_TIME_S = 1.0
MAX_WRITTEN_STIFFNESS = 1e15
"""Contact stiffness [N/m] or damping; greater values are suspicious."""
GAZEBO_STEP_S = 1e-3
"""Gazebo's default step: its decay is a share of the velocity per step."""
MAX_DECAY_SHARE = 1.0 - 1e-6
MAX_BOUNCE_THRESHOLD_MPS = 100.0
"""Threshold above which nothing rebounds: exporters write 100000, the default of SDF."""
UNUSED_SURFACE_TAGS = {
    "maxVel": "penetration is corrected by a fifth per step, at 0.2 m/s at most",
    "minDepth": "penetration is corrected from depth 0 on",
}
SURFACE_TAG_NAMES = {
    "mu1": "mu1",
    "mu2": "mu2",
    "fdir1": "fdir1",
    "kp": "kp",
    "kd": "kd",
    "minDepth": "minDepth",
    "min_depth": "minDepth",
    "maxVel": "maxVel",
    "max_vel": "maxVel",
    "gravity": "gravity",
    "turnGravityOff": "turnGravityOff",
    "dampingFactor": "dampingFactor",
    "selfCollide": "selfCollide",
    "self_collide": "selfCollide",
}
"""Tags by spelling."""
FRICTION_PATHS = ("surface/friction/ode/mu", "surface/friction/bullet/friction")
"""Paths in a <collision> of SDF; the first with a text is used."""
SURFACE_PATHS = {
    "mu2": "surface/friction/ode/mu2",
    "fdir1": "surface/friction/ode/fdir1",
    "kp": "surface/contact/ode/kp",
    "kd": "surface/contact/ode/kd",
    "maxVel": "surface/contact/ode/max_vel",
    "minDepth": "surface/contact/ode/min_depth",
    "restitution_coefficient": "surface/bounce/restitution_coefficient",
    "threshold": "surface/bounce/threshold",
}
"""Paths in a <collision> of SDF, by the names of URDF and of `SurfaceTagReader`."""
_NOT_SIMULATED = "not simulated"
_OF_ODE = "the values of <ode> are read"
_NO_MASKS = "collisions are not filtered: everything collides with everything"
SURFACE_RULE = make_tree(
    (*FRICTION_PATHS, *SURFACE_PATHS.values()),
    {
        "surface/friction/ode/slip1": ElementRule(unread=_NOT_SIMULATED, idle=("0", "0.0")),
        "surface/friction/ode/slip2": ElementRule(unread=_NOT_SIMULATED, idle=("0", "0.0")),
        "surface/friction/bullet/friction2": ElementRule(unread=_OF_ODE),
        "surface/friction/bullet/fdir1": ElementRule(unread=_OF_ODE),
        "surface/friction/bullet/rolling_friction": ElementRule(unread=_NOT_SIMULATED),
        "surface/friction/torsional": ElementRule(unread=_NOT_SIMULATED),
        "surface/contact/ode/soft_cfm": ElementRule(unread=_NOT_SIMULATED, idle=("0", "0.0")),
        "surface/contact/ode/soft_erp": ElementRule(unread=_NOT_SIMULATED, idle=("0.2",)),
        "surface/contact/bullet": ElementRule(unread=_OF_ODE),
        "surface/contact/collide_without_contact": ElementRule(
            unread="every contact has forces", idle=("0", "false")
        ),
        "surface/contact/collide_without_contact_bitmask": ElementRule(
            unread=_NO_MASKS, idle=("1",)
        ),
        "surface/contact/collide_bitmask": ElementRule(unread=_NO_MASKS, idle=("65535", "0xffff")),
        "surface/contact/category_bitmask": ElementRule(unread=_NO_MASKS, idle=("65535", "0xffff")),
        "surface/contact/poissons_ratio": ElementRule(unread=_NOT_SIMULATED),
        "surface/contact/elastic_modulus": ElementRule(unread=_NOT_SIMULATED),
        "surface/soft_contact": ElementRule(unread=_NOT_SIMULATED),
    },
)["surface"]
"""A <surface> of SDF."""


def read_surface_texts(collision: Element) -> dict[str, str]:
    """Find the texts of the <surface> of a <collision> of SDF."""
    friction = next(
        (path for path in FRICTION_PATHS if _find_text(collision, path)), FRICTION_PATHS[0]
    )
    paths = {"mu1": friction} | SURFACE_PATHS
    return {tag: text for tag, path in paths.items() if (text := _find_text(collision, path))}


def _find_text(owner: Element, path: str) -> str:
    return (owner.findtext(path) or "").strip()


class SurfaceParameters(msgspec.Struct, frozen=True):
    """Surface of one link or collision; None: not set."""

    friction: float | None = None
    contact: Contact = Contact()
    has_gravity: bool = True
    decay: Decay = Decay()
    self_collides: bool = False

    def apply_to_shape(self, shape: Shape) -> Shape:
        """Set the surface of a collision."""
        friction = shape.friction if self.friction is None else self.friction
        along = rotate(shape.origin.orientation, self.contact.direction)
        contact = msgspec.structs.replace(self.contact, direction=along)
        return msgspec.structs.replace(shape, friction=friction, contact=contact)

    def apply_to_link(self, link: Link) -> Link:
        """Set the surface of a link before lumping."""
        return msgspec.structs.replace(
            link,
            collisions=tuple(map(self.apply_to_shape, link.collisions)),
            weightless=Inertial() if self.has_gravity else link.inertial,
            decay=self.decay,
            self_collides=self.self_collides,
        )


class SurfaceTagReader:
    """Reads the surface tags of one link or collision; unusable values are reported.

    Args:
        texts: By the values of `SURFACE_TAG_NAMES`.
        subject: Start of the report entries, such as `gazebo 'wheel'`.
        slug: Of the error for a bad friction.
        report: Gets what is unusual.
    """

    def __init__(
        self, texts: Mapping[str, str], *, subject: str, slug: str, report: ParseReport
    ) -> None:
        self._texts = texts
        self._subject = subject
        self._slug = slug
        self._report = report

    def read(self) -> SurfaceParameters:
        """Read all tags.

        Raises:
            ModelError: mu1 is not a number >= 0.
        """
        for tag, reason in UNUSED_SURFACE_TAGS.items():
            if tag in self._texts:
                self._report.ignored(self._subject_of(tag), reason)
        friction, direction, across = self._read_frictions()
        stiffness, damping = self._read_stiffness()
        return SurfaceParameters(
            friction=friction,
            contact=Contact(stiffness, damping, direction, across, *self._read_bounce()),
            has_gravity=self._read_gravity(),
            decay=self._read_decay(),
            self_collides=self._read_flag("selfCollide"),
        )

    def _subject_of(self, tag: str) -> str:
        return f"{self._subject}: <{tag}>"

    def _read_frictions(self) -> tuple[float | None, Vec3, float]:
        along = self._read_friction()
        is_infinite = self._texts.get("mu2", "").strip().lower() in INFINITY_TEXTS
        across = INFINITE_FRICTION if is_infinite else self._read_number("mu2")
        direction = self._read_direction()
        first = DEFAULT_FRICTION if along is None else along
        if across is None or across == first:
            if across is not None:
                self._report.applied(self._subject_of("mu2"))
            if direction is not None:
                self._report.ignored(self._subject_of("fdir1"), "needs different <mu1> and <mu2>")
            return (first if across is not None else along), ZERO, 0.0
        if direction is not None:
            self._report.applied(
                self._subject_of("mu2"), f"{across:g} across <fdir1>, {first:g} along it"
            )
            return first, direction, across
        mean = (first + across) / 2.0
        self._report.applied(
            self._subject_of("mu2"),
            f"no <fdir1>: {mean:g}, the mean of mu1 and mu2, in all directions",
        )
        return mean, ZERO, 0.0

    def _read_friction(self) -> float | None:
        if "mu1" not in self._texts:
            return None
        where = f"{self._subject}, mu1"
        if self._texts["mu1"].strip().lower() in INFINITY_TEXTS:
            self._report.applied(self._subject_of("mu1"), f"infinite: {INFINITE_FRICTION:g}")
            return INFINITE_FRICTION
        (friction,) = read_numbers(self._texts["mu1"], counts=(1,), where=where, slug=self._slug)
        if friction < 0.0:
            raise ModelError(
                f"{where}: {friction:g} is negative; write a coefficient >= 0", slug=self._slug
            )
        self._report.applied(self._subject_of("mu1"))
        return friction

    def _read_direction(self) -> Vec3 | None:
        if (numbers := self._read_numbers("fdir1", 3)) is None:
            return None
        length = math.hypot(*numbers)
        if length == 0.0 or not math.isfinite(length):
            return None
        x, y, z = numbers
        return (x / length, y / length, z / length)

    def _read_stiffness(self) -> tuple[float, float]:
        stiffness, damping = self._read_number("kp"), self._read_number("kd")
        if not stiffness:
            if stiffness is not None:
                self._report.suspicious(self._subject_of("kp"), "0 supports no weight; rigid")
            if damping is not None:
                self._report.ignored(self._subject_of("kd"), "rigid contacts; add <kp>")
            return 0.0, 0.0
        used, used_damping = clamp_contact(
            stiffness, DEFAULT_CONTACT_DAMPING if damping is None else damping
        )
        is_rigid = used == RIGID_STIFFNESS and used_damping <= MAX_RIGID_TIME_S * used
        self._report_stiffness("kp", used, "rigid" if is_rigid else f"{used:g} N/m at each point")
        if damping is not None:
            self._report_stiffness("kd", used_damping, "or more, to limit the rebound")
        return (0.0, 0.0) if is_rigid else (used, used_damping)

    def _read_bounce(self) -> tuple[float | None, float]:
        """Read the coefficient of restitution, and the speed [m/s] up to which it is 0."""
        written, threshold = self._read_number("restitution_coefficient"), 0.0
        if written is None:
            if "threshold" in self._texts:
                reason = "no <restitution_coefficient>: nothing rebounds"
                self._report.ignored(self._subject_of("threshold"), reason)
            return None, 0.0
        subject = self._subject_of("restitution_coefficient")
        if written > 1.0:
            self._report.suspicious(subject, f"{written:g} would add energy; 1 is used")
        if "threshold" in self._texts:
            threshold = self._read_number("threshold") or 0.0
            self._report.applied(self._subject_of("threshold"))
        if written == 0.0 or threshold > MAX_BOUNCE_THRESHOLD_MPS:
            self._report.applied(subject, "no rebound" if written else "")
            return 0.0, 0.0
        self._report.applied(
            subject, f"impacts above {threshold:g} m/s rebound at {min(written, 1.0):g} of it"
        )
        return min(written, 1.0), threshold

    def _report_stiffness(self, tag: str, used: float, effect: str) -> None:
        written = self._texts[tag][:40]
        if float(self._texts[tag]) > MAX_WRITTEN_STIFFNESS:
            self._report.suspicious(
                self._subject_of(tag), f"{written} is too stiff; {used:g} is used"
            )
        else:
            self._report.applied(self._subject_of(tag), effect)

    def _read_gravity(self) -> bool:
        has_gravity = self._read_flag("gravity", default=True) and not self._read_flag(
            "turnGravityOff"
        )
        for tag in ("gravity", "turnGravityOff"):
            if tag in self._texts:
                self._report.applied(
                    self._subject_of(tag), "" if has_gravity else "without gravity"
                )
        return has_gravity

    def _read_decay(self) -> Decay:
        share = self._read_number("dampingFactor")
        if not share:
            return Decay()
        self._report.applied(
            self._subject_of("dampingFactor"),
            f"velocities decay by {100.0 * share:g} % per millisecond",
        )
        rate = to_decay_rate(share)
        return Decay(rate, rate)

    def _read_flag(self, tag: str, *, default: bool = False) -> bool:
        text = self._texts.get(tag)
        if text is None:
            return default
        is_set = parse_flag(text or "false")
        if is_set is None:
            self._report.suspicious(
                self._subject_of(tag), f"{text[:40]!r} is neither true nor false"
            )
            return default
        if tag == "selfCollide":
            self._report.applied(self._subject_of(tag), "" if is_set else "the default")
        return is_set

    def _read_number(self, tag: str) -> float | None:
        numbers = self._read_numbers(tag, 1)
        if numbers is None or numbers[0] >= 0.0:
            return None if numbers is None else numbers[0]
        self._report.suspicious(self._subject_of(tag), f"{numbers[0]:g} is negative; not used")
        return None

    def _read_numbers(self, tag: str, count: int) -> tuple[float, ...] | None:
        if tag not in self._texts:
            return None
        text = self._texts[tag]
        try:
            return read_numbers(text, counts=(count,), where=tag, slug=self._slug)
        except ModelError:
            fault = f"{text[:40]!r} is not {count} number(s); not used"
            self._report.suspicious(self._subject_of(tag), fault)
            return None


def to_decay_rate(share: float) -> float:
    """Find the decay rate [1/s] of a velocity that loses a share in each Gazebo step."""
    return -math.log1p(-min(share, MAX_DECAY_SHARE)) / GAZEBO_STEP_S


def clamp_contact(stiffness: float, damping: float) -> tuple[float, float]:
    """Limit stiffness [N/m] and damping [N s/m] to the range of engines.

    Their ratio, the time to correct a penetration, is kept: otherwise the stiffest of several feet
    carries all the weight.
    """
    clamped = min(stiffness, RIGID_STIFFNESS)
    return clamped, min(damping * (clamped / stiffness), MAX_CONTACT_TIME_S * clamped)
