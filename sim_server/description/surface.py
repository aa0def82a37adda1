"""How links touch, fall and slow down: what descriptions ask for, and what becomes of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import ZERO, Contact, Decay, Inertial, Shape, Vec3
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.transforms import turned
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zensim.proto.messages.model_messages import Link
    from zensim.sim_server.description.report import Report

FRICTION = 1.0
"""Coulomb coefficient where none is written, as in Gazebo."""
DAMPING = 1.0
"""Contact damping [N s/m] where none is written, as in Gazebo."""
RIGID = 1e9
"""Contact stiffness [N/m] from which on nothing sinks in."""
SLOW_S = 0.01
"""Damping over stiffness up to which rigid contacts are no slower than they are anyway."""
SLOWEST_S = 1.0
STIFFEST = 1e15
"""Contact stiffness [N/m] or damping beyond which nothing is meant."""
GAZEBO_STEP_S = 1e-3
"""Gazebo takes a share off velocities each step; so long is its step unless told otherwise."""
MOST_DECAY = 1.0 - 1e-6
TRUE, FALSE = ("true", "1"), ("false", "0", "")
UNUSED = {
    "maxVel": "what has sunk in is pushed out by a fifth of its depth each step, at any speed",
    "minDepth": "what has sunk in is pushed out from depth 0 on",
}
TAGS = {
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


class Surface(msgspec.Struct, frozen=True):
    """What is asked for of one link or collision; None where nothing is."""

    friction: float | None = None
    contact: Contact = Contact()
    has_gravity: bool = True
    decay: Decay = Decay()
    self_collides: bool = False

    def on(self, shape: Shape) -> Shape:
        """Give a collision this surface."""
        friction = shape.friction if self.friction is None else self.friction
        along = turned(shape.origin, self.contact.direction)
        contact = msgspec.structs.replace(self.contact, direction=along)
        return msgspec.structs.replace(shape, friction=friction, contact=contact)

    def under(self, link: Link) -> Link:
        """Give a link, before it is lumped, what it asks for."""
        return msgspec.structs.replace(
            link,
            collisions=tuple(map(self.on, link.collisions)),
            weightless=Inertial() if self.has_gravity else link.inertial,
            decay=self.decay,
            self_collides=self.self_collides,
        )


class SurfaceTags:
    """Tags of one link or collision by name; what cannot be used is noted.

    Args:
        texts: What is written, by the names that `TAGS` gives.
        subject: Begins each entry of the report, such as `gazebo 'wheel'`.
        slug: Of a friction that cannot be.
        report: Where oddities go.
    """

    def __init__(
        self, texts: Mapping[str, str], *, subject: str, slug: str, report: Report
    ) -> None:
        self._texts = texts
        self._subject = subject
        self._slug = slug
        self._report = report

    def read(self) -> Surface:
        """Read all.

        Raises:
            ModelError: mu1 is no number, or negative.
        """
        for tag, reason in UNUSED.items():
            if tag in self._texts:
                self._report.ignored(self._of(tag), reason)
        friction, direction, across = self._frictions()
        stiffness, damping = self._stiffness()
        return Surface(
            friction=friction,
            contact=Contact(stiffness, damping, direction, across),
            has_gravity=self._has_gravity(),
            decay=self._decay(),
            self_collides=self._flag("selfCollide"),
        )

    def _of(self, tag: str) -> str:
        return f"{self._subject}: <{tag}>"

    def _frictions(self) -> tuple[float | None, Vec3, float]:
        along = self._friction()
        across = self._number("mu2")
        direction = self._direction()
        first = FRICTION if along is None else along
        if across is None or across == first:
            if across is not None:
                self._report.applied(self._of("mu2"))
            if direction is not None:
                self._report.ignored(self._of("fdir1"), "needs a <mu1> and a <mu2> that differ")
            return (first if across is not None else along), ZERO, 0.0
        if direction is not None:
            self._report.applied(self._of("mu2"), f"{across:g} across <fdir1>, {first:g} along it")
            return first, direction, across
        mean = (first + across) / 2.0
        self._report.applied(
            self._of("mu2"), f"there is no <fdir1>: {mean:g} every way, the mean of mu1 and mu2"
        )
        return mean, ZERO, 0.0

    def _friction(self) -> float | None:
        if "mu1" not in self._texts:
            return None
        where = f"{self._subject}, mu1"
        (friction,) = read_numbers(self._texts["mu1"], counts=(1,), where=where, slug=self._slug)
        if friction < 0.0:
            raise ModelError(
                f"{where}: {friction:g} is negative; write a coefficient >= 0", slug=self._slug
            )
        self._report.applied(self._of("mu1"))
        return friction

    def _direction(self) -> Vec3 | None:
        if (numbers := self._numbers("fdir1", 3)) is None:
            return None
        length = math.hypot(*numbers)
        if length == 0.0 or not math.isfinite(length):
            return None
        x, y, z = numbers
        return (x / length, y / length, z / length)

    def _stiffness(self) -> tuple[float, float]:
        stiffness, damping = self._number("kp"), self._number("kd")
        if not stiffness:
            if stiffness is not None:
                self._report.suspicious(self._of("kp"), "0 would hold nothing up; rigid")
            if damping is not None:
                self._report.ignored(self._of("kd"), "needs a <kp>; without it contacts are rigid")
            return 0.0, 0.0
        firm, slow = in_bounds(stiffness, DAMPING if damping is None else damping)
        is_rigid = firm == RIGID and slow <= SLOW_S * firm
        self._note_stiff("kp", firm, "rigid" if is_rigid else f"{firm:g} N/m at each point")
        if damping is not None:
            self._note_stiff("kd", slow, "or more, so that nothing that has sunk in jumps out")
        return (0.0, 0.0) if is_rigid else (firm, slow)

    def _note_stiff(self, tag: str, used: float, effect: str) -> None:
        written = self._texts[tag][:40]
        if float(self._texts[tag]) > STIFFEST:
            self._report.suspicious(
                self._of(tag), f"{written} is stiffer than anything; taken as {used:g}"
            )
        else:
            self._report.applied(self._of(tag), effect)

    def _has_gravity(self) -> bool:
        has_gravity = self._flag("gravity", default=True) and not self._flag("turnGravityOff")
        for tag in ("gravity", "turnGravityOff"):
            if tag in self._texts:
                self._report.applied(
                    self._of(tag), "" if has_gravity else "gravity does not pull it"
                )
        return has_gravity

    def _decay(self) -> Decay:
        share = self._number("dampingFactor")
        if not share:
            return Decay()
        self._report.applied(
            self._of("dampingFactor"), f"velocities lose {100.0 * share:g} % in a millisecond"
        )
        rate = decay_rate(share)
        return Decay(rate, rate)

    def _flag(self, tag: str, *, default: bool = False) -> bool:
        text = self._texts.get(tag)
        if text is None:
            return default
        if text.lower() not in (*TRUE, *FALSE):
            self._report.suspicious(self._of(tag), f"{text[:40]!r} is neither true nor false")
            return default
        is_set = text.lower() in TRUE
        if tag == "selfCollide":
            self._report.applied(self._of(tag), "" if is_set else "as by default")
        return is_set

    def _number(self, tag: str) -> float | None:
        numbers = self._numbers(tag, 1)
        if numbers is None or numbers[0] >= 0.0:
            return None if numbers is None else numbers[0]
        self._report.suspicious(self._of(tag), f"{numbers[0]:g} is negative; not used")
        return None

    def _numbers(self, tag: str, count: int) -> tuple[float, ...] | None:
        if tag not in self._texts:
            return None
        text = self._texts[tag]
        try:
            return read_numbers(text, counts=(count,), where=tag, slug=self._slug)
        except ModelError:
            self._report.suspicious(self._of(tag), f"{text[:40]!r} is no number; not used")
            return None


def decay_rate(share: float) -> float:
    """Find how fast [1/s] a velocity dies down that loses a share of itself in each Gazebo step."""
    return -math.log1p(-min(share, MOST_DECAY)) / GAZEBO_STEP_S


def in_bounds(stiffness: float, damping: float) -> tuple[float, float]:
    """Bring a contact within bounds that engines compute with.

    The ratio says how long a contact takes to push out what has sunk in, and is kept: where all
    of a robot's feet were rigid and hard, those that give less would carry everything.
    """
    firm = min(stiffness, RIGID)
    return firm, min(damping * (firm / stiffness), SLOWEST_S * firm)
