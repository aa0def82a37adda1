"""Surfaces of links: friction, contact, gravity, velocity decay and colour."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import ZERO, Contact, Decay, Inertial, Shape, Vec3
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.strict_parsing import read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link, Quat
    from zensim.sim_server.description.report import ParseReport

GAZEBO_COLOURS: dict[str, Quat] = {
    "Black": (0.0, 0.0, 0.0, 1.0),
    "Blue": (0.0, 0.0, 1.0, 1.0),
    "BlueGlow": (0.0, 0.0, 1.0, 1.0),
    "BlueTransparent": (0.0, 0.0, 1.0, 0.5),
    "DarkGrey": (0.175, 0.175, 0.175, 1.0),
    "DarkYellow": (0.7, 0.7, 0.0, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
    "Gold": (0.8, 0.65, 0.1, 1.0),
    "Gray": (0.7, 0.7, 0.7, 1.0),
    "Green": (0.0, 1.0, 0.0, 1.0),
    "GreenGlow": (0.0, 1.0, 0.0, 1.0),
    "GreenTransparent": (0.0, 1.0, 0.0, 0.5),
    "Grey": (0.7, 0.7, 0.7, 1.0),
    "Indigo": (0.33, 0.0, 0.5, 1.0),
    "Orange": (1.0, 0.5, 0.05, 1.0),
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
    "ZincYellow": (0.97, 0.95, 0.21, 1.0),
}


RGB_COUNT = 3


def find_gazebo_colour(name: str) -> Quat | None:
    """Find the colour (r, g, b, a) that Gazebo calls `Gazebo/<name>`; None when it is not known."""
    return GAZEBO_COLOURS.get(name.strip().removeprefix("Gazebo/"))


def read_named_colours(robot: Element, report: ParseReport) -> dict[str, Quat]:
    """List the materials of a URDF that have a colour, also those inside a visual.

    Of two with one name the first counts, those of the robot itself before those of visuals.
    """
    colours: dict[str, Quat] = {}
    for path in ("material", "link/visual/material"):
        for material in robot.findall(path):
            colour, name = material.find("color"), material.get("name")
            if colour is not None and name:
                colours.setdefault(name, _read_rgba(colour, name, report))
    return colours


def read_visual_colour(
    visual: Element, colours: dict[str, Quat], report: ParseReport
) -> Quat | None:
    """Find the colour of a visual: its own, else that of its material's name."""
    material = visual.find("material")
    if material is None:
        return None
    name = material.get("name") or ""
    colour = material.find("color")
    if colour is not None:
        return _read_rgba(colour, name, report)
    if name not in colours and material.find("texture") is None:
        report.suspicious(f"material {name[:80]!r}", "no <material> of this name has a colour")
    return colours.get(name)


def _read_rgba(colour: Element, name: str, report: ParseReport) -> Quat:
    where = f"material {name[:80]!r}"
    written = read_numbers(
        colour.get("rgba", "1 1 1 1"), counts=(3, 4), where=where, slug="urdf.number"
    )
    if len(written) == RGB_COUNT:
        report.suspicious(where, "its colour has three numbers; opaque")
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    if (r, g, b, a) != written:
        report.suspicious(where, "colours lie in 0 to 1; cut to it")
    return (r, g, b, a)


DEFAULT_FRICTION = 1.0
"""Coulomb coefficient where none is written, as in Gazebo."""
DEFAULT_CONTACT_DAMPING = 1.0
"""Contact damping [N s/m] where none is written, as in Gazebo."""
RIGID_STIFFNESS = 1e9
"""Contact stiffness [N/m] from which on nothing sinks in."""
MAX_RIGID_TIME_S = 0.01
"""Damping over stiffness up to which rigid contacts are no slower than they are anyway."""
MAX_CONTACT_TIME_S = 1.0
MAX_WRITTEN_STIFFNESS = 1e15
"""Contact stiffness [N/m] or damping beyond which nothing is meant."""
GAZEBO_STEP_S = 1e-3
"""Gazebo takes a share off velocities each step; so long is its step unless told otherwise."""
MAX_DECAY_SHARE = 1.0 - 1e-6
TRUE, FALSE = ("true", "1"), ("false", "0", "")
UNUSED_SURFACE_TAGS = {
    "maxVel": "what has sunk in is pushed out by a fifth of its depth each step, at any speed",
    "minDepth": "what has sunk in is pushed out from depth 0 on",
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
"""Every spelling of a tag that is read here."""


class SurfaceParameters(msgspec.Struct, frozen=True):
    """What is asked for of one link or collision; None where nothing is."""

    friction: float | None = None
    contact: Contact = Contact()
    has_gravity: bool = True
    decay: Decay = Decay()
    self_collides: bool = False

    def apply_to_shape(self, shape: Shape) -> Shape:
        """Give a collision this surface."""
        friction = shape.friction if self.friction is None else self.friction
        along = rotate(shape.origin.orientation, self.contact.direction)
        contact = msgspec.structs.replace(self.contact, direction=along)
        return msgspec.structs.replace(shape, friction=friction, contact=contact)

    def apply_to_link(self, link: Link) -> Link:
        """Give a link, before it is lumped, what it asks for."""
        return msgspec.structs.replace(
            link,
            collisions=tuple(map(self.apply_to_shape, link.collisions)),
            weightless=Inertial() if self.has_gravity else link.inertial,
            decay=self.decay,
            self_collides=self.self_collides,
        )


class SurfaceTagReader:
    """Tags of one link or collision by name; what cannot be used is noted.

    Args:
        texts: What is written, by the names that `SURFACE_TAG_NAMES` gives.
        subject: Begins each entry of the report, such as `gazebo 'wheel'`.
        slug: Of a friction that cannot be.
        report: Where oddities go.
    """

    def __init__(
        self, texts: Mapping[str, str], *, subject: str, slug: str, report: ParseReport
    ) -> None:
        self._texts = texts
        self._subject = subject
        self._slug = slug
        self._report = report

    def read(self) -> SurfaceParameters:
        """Read all.

        Raises:
            ModelError: mu1 is no number, or negative.
        """
        for tag, reason in UNUSED_SURFACE_TAGS.items():
            if tag in self._texts:
                self._report.ignored(self._subject_of(tag), reason)
        friction, direction, across = self._read_frictions()
        stiffness, damping = self._read_stiffness()
        return SurfaceParameters(
            friction=friction,
            contact=Contact(stiffness, damping, direction, across),
            has_gravity=self._read_gravity(),
            decay=self._read_decay(),
            self_collides=self._read_flag("selfCollide"),
        )

    def _subject_of(self, tag: str) -> str:
        return f"{self._subject}: <{tag}>"

    def _read_frictions(self) -> tuple[float | None, Vec3, float]:
        along = self._read_friction()
        across = self._read_number("mu2")
        direction = self._read_direction()
        first = DEFAULT_FRICTION if along is None else along
        if across is None or across == first:
            if across is not None:
                self._report.applied(self._subject_of("mu2"))
            if direction is not None:
                self._report.ignored(
                    self._subject_of("fdir1"), "needs a <mu1> and a <mu2> that differ"
                )
            return (first if across is not None else along), ZERO, 0.0
        if direction is not None:
            self._report.applied(
                self._subject_of("mu2"), f"{across:g} across <fdir1>, {first:g} along it"
            )
            return first, direction, across
        mean = (first + across) / 2.0
        self._report.applied(
            self._subject_of("mu2"),
            f"there is no <fdir1>: {mean:g} every way, the mean of mu1 and mu2",
        )
        return mean, ZERO, 0.0

    def _read_friction(self) -> float | None:
        if "mu1" not in self._texts:
            return None
        where = f"{self._subject}, mu1"
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
                self._report.suspicious(self._subject_of("kp"), "0 would hold nothing up; rigid")
            if damping is not None:
                self._report.ignored(
                    self._subject_of("kd"), "needs a <kp>; without it contacts are rigid"
                )
            return 0.0, 0.0
        firm, slow = clamp_contact(
            stiffness, DEFAULT_CONTACT_DAMPING if damping is None else damping
        )
        is_rigid = firm == RIGID_STIFFNESS and slow <= MAX_RIGID_TIME_S * firm
        self._report_stiffness("kp", firm, "rigid" if is_rigid else f"{firm:g} N/m at each point")
        if damping is not None:
            self._report_stiffness(
                "kd", slow, "or more, so that nothing that has sunk in jumps out"
            )
        return (0.0, 0.0) if is_rigid else (firm, slow)

    def _report_stiffness(self, tag: str, used: float, effect: str) -> None:
        written = self._texts[tag][:40]
        if float(self._texts[tag]) > MAX_WRITTEN_STIFFNESS:
            self._report.suspicious(
                self._subject_of(tag), f"{written} is stiffer than anything; taken as {used:g}"
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
                    self._subject_of(tag), "" if has_gravity else "gravity does not pull it"
                )
        return has_gravity

    def _read_decay(self) -> Decay:
        share = self._read_number("dampingFactor")
        if not share:
            return Decay()
        self._report.applied(
            self._subject_of("dampingFactor"),
            f"velocities lose {100.0 * share:g} % in a millisecond",
        )
        rate = to_decay_rate(share)
        return Decay(rate, rate)

    def _read_flag(self, tag: str, *, default: bool = False) -> bool:
        text = self._texts.get(tag)
        if text is None:
            return default
        if text.lower() not in (*TRUE, *FALSE):
            self._report.suspicious(
                self._subject_of(tag), f"{text[:40]!r} is neither true nor false"
            )
            return default
        is_set = text.lower() in TRUE
        if tag == "selfCollide":
            self._report.applied(self._subject_of(tag), "" if is_set else "as by default")
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
            self._report.suspicious(self._subject_of(tag), f"{text[:40]!r} is no number; not used")
            return None


def to_decay_rate(share: float) -> float:
    """Find how fast [1/s] a velocity dies down that loses a share of itself in each Gazebo step."""
    return -math.log1p(-min(share, MAX_DECAY_SHARE)) / GAZEBO_STEP_S


def clamp_contact(stiffness: float, damping: float) -> tuple[float, float]:
    """Bring a contact within bounds that engines compute with.

    The ratio says how long a contact takes to push out what has sunk in, and is kept: where all
    of a robot's feet were rigid and hard, those that give less would carry everything.
    """
    firm = min(stiffness, RIGID_STIFFNESS)
    return firm, min(damping * (firm / stiffness), MAX_CONTACT_TIME_S * firm)
