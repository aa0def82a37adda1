"""What an SDF world says of its physics and its light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.world_messages import DOWNWARD, Light, LightKind, Scene
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.sdf_values import read_pose, read_scalar, read_text, read_vector
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.report import Report

LIGHT_KINDS: dict[str, LightKind] = {
    "point": "point",
    "spot": "spot",
    "directional": "directional",
}
RGB = 3
SHORTEST_S, LONGEST_S = 1e-4, 1.0
FASTEST = 1000.0


class Pace(msgspec.Struct, frozen=True):
    """How a world wants to be stepped; None where it does not say."""

    step_s: float | None = None
    real_time_factor: float | None = None


def read_pace(physics: Element, report: Report) -> Pace:
    """Read the step [s] and the real-time factor of a <physics>.

    Raises:
        ModelError: One is no number, or out of range.
    """
    step = _ranged(physics, "max_step_size", (SHORTEST_S, LONGEST_S))
    factor = _ranged(physics, "real_time_factor", (0.0, FASTEST))
    rate = _ranged(physics, "real_time_update_rate", (0.0, 1e6))
    if rate is not None:
        # Gazebo makes this many steps a second, whatever the factor says; 0 is flat out.
        factor = min(rate * (step or 0.001), FASTEST)
    for child in physics:
        if child.tag in ("max_step_size", "real_time_factor", "real_time_update_rate"):
            report.applied(f"physics: <{child.tag}>", (child.text or "").strip()[:40])
        else:
            report.ignored(f"physics: <{child.tag[:80]}>", "for other engines")
    return Pace(step, factor)


def read_scene(scene: Element, report: Report) -> Scene:
    """Read the colours of a <scene>.

    Raises:
        ModelError: One is no numbers.
    """
    for child in scene:
        if child.tag not in ("ambient", "background"):
            report.ignored(f"scene: <{child.tag[:80]}>", "the page draws plain colours")
    return Scene(_colour(scene, "ambient"), _colour(scene, "background"))


def read_light(light: Element, report: Report) -> Light | None:
    """Read a <light>; None, noted, when its type is none.

    Raises:
        ModelError: A number is none.
    """
    name = (light.get("name") or "")[:80]
    where = f"light {shown(name)}"
    kind = LIGHT_KINDS.get(light.get("type") or "")
    if kind is None:
        report.unknown(where, f"no light is of type {shown(light.get('type'))}")
        return None
    report.applied(where, kind)
    return Light(
        name=name,
        kind=kind,
        origin=read_pose(light, where).origin,
        direction=read_vector(light, "direction", DOWNWARD, where),
        rgba=_colour(light, "diffuse") or (1.0, 1.0, 1.0, 1.0),
    )


def _ranged(physics: Element, tag: str, bounds: tuple[float, float]) -> float | None:
    if not read_text(physics, tag):
        return None
    number = read_scalar(physics, tag, 0.0, "physics")
    if not bounds[0] <= number <= bounds[1]:
        raise ModelError(
            f"physics, {tag}: {number:g} is out of range; use {bounds[0]:g} to {bounds[1]:g}",
            slug="sdf.physics",
        )
    return number


def _colour(owner: Element, tag: str) -> Quat | None:
    text = read_text(owner, tag)
    if not text:
        return None
    where = f"{owner.tag}, {tag}"
    written = read_numbers(text, counts=(3, 4), where=where, slug="sdf.number")
    if len(written) == RGB:
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    return (r, g, b, a)
