"""Values of SDF elements: numbers, vectors, flags, names, poses, zensim's own tags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Origin, Vec3
from zensim.proto.rigid_transforms import from_rpy
from zensim.sim_server.description.strict_parsing import quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

ZENSIM_PREFIX = "zensim:"


def zensim_tag(child: Element) -> str:
    """Name an element of ours without its prefix; empty for others."""
    tag = str(child.tag)
    if tag.startswith(ZENSIM_PREFIX):
        return tag.removeprefix(ZENSIM_PREFIX)
    space, separator, name = tag.rpartition("}")
    return name if separator and "zensim" in space else ""


MAX_POSITION_M = 1e9
"""Of a pose: beyond it, nothing is left of a millimetre."""
MAX_NAME_LENGTH = 256
INFINITY_TEXTS = ("inf", "+inf", "-inf", "infinity", "-infinity")
TRUE_TEXTS, FALSE_TEXTS = ("true", "1"), ("false", "0", "")


class RelativePose(msgspec.Struct, frozen=True):
    """A <pose> as written; an empty `frame` means the one that its owner implies."""

    origin: Origin = Origin()
    frame: str = ""


def read_text(owner: Element, tag: str, default: str = "") -> str:
    """Read the text of the first child of a tag; an empty one is as none."""
    return (owner.findtext(tag) or "").strip() or default


def read_vector(owner: Element, tag: str, default: Vec3, where: str) -> Vec3:
    """Read three numbers.

    Raises:
        ModelError: They are not.
    """
    text = read_text(owner, tag)
    if not text:
        return default
    x, y, z = read_numbers(text, counts=(3,), where=f"{where}, {tag}", slug="sdf.number")
    return (x, y, z)


def read_scalar(owner: Element, tag: str, default: float, where: str) -> float:
    """Read a number.

    Raises:
        ModelError: It is none.
    """
    text = read_text(owner, tag)
    if not text:
        return default
    return read_numbers(text, counts=(1,), where=f"{where}, {tag}", slug="sdf.number")[0]


def read_bound(owner: Element, tag: str, default: float, where: str) -> float:
    """Read a number that may be infinite, as limits may.

    Raises:
        ModelError: It is no number.
    """
    text = read_text(owner, tag).lower()
    return float(text) if text in INFINITY_TEXTS else read_scalar(owner, tag, default, where)


def read_flag(owner: Element, tag: str, *, default: bool, where: str) -> bool:
    """Read true, false, 1 or 0.

    Raises:
        ModelError: It is none of these.
    """
    found = owner.find(tag)
    if found is None:
        return default
    text = (found.text or "").strip().lower()
    if text not in (*TRUE_TEXTS, *FALSE_TEXTS):
        raise ModelError(
            f"{where}, {tag}: {quote(text)} is no flag; write true or false", slug="sdf.flag"
        )
    return text in TRUE_TEXTS


def read_name(element: Element, where: str) -> str:
    """Read the name of an element.

    Raises:
        ModelError: There is none, or it cannot be one.
    """
    name = (element.get("name") or "").strip()
    if not name or len(name) > MAX_NAME_LENGTH or not name.isprintable():
        raise ModelError(
            f"{where}: name {quote(name)} cannot be used; write 1 to {MAX_NAME_LENGTH} "
            "printable characters",
            slug="sdf.name",
        )
    if name == "world" or (name.startswith("__") and name.endswith("__")):
        raise ModelError(
            f"{where}: name {quote(name)} is reserved by SDF; choose another", slug="sdf.name"
        )
    return name


def read_pose(owner: Element, where: str) -> RelativePose:
    """Read the <pose> of an element; identity in the implied frame when there is none.

    Raises:
        ModelError: Its numbers are none, too many or too few, or lie out of reach.
    """
    pose = owner.find("pose")
    if pose is None:
        return RelativePose()
    frame = (pose.get("relative_to") or pose.get("frame") or "").strip()
    if not (pose.text or "").strip():
        return RelativePose(frame=frame)
    is_quaternion = pose.get("rotation_format") == "quat_xyzw"
    numbers = read_numbers(
        pose.text,
        counts=(7,) if is_quaternion else (6,),
        where=f"{where}, pose",
        slug="sdf.pose",
    )
    x, y, z = numbers[:3]
    if max(map(abs, (x, y, z))) > MAX_POSITION_M:
        raise ModelError(
            f"{where}, pose: {quote(pose.text)} lies out of reach; use at most {MAX_POSITION_M:g} m",
            slug="sdf.pose",
        )
    turn = numbers[3:]
    if is_quaternion:
        return RelativePose(Origin((x, y, z), _normalize_quaternion(turn, where)), frame)
    if pose.get("degrees") in TRUE_TEXTS:
        turn = tuple(map(math.radians, turn))
    return RelativePose(_make_origin((x, y, z), turn), frame)


def _make_origin(position: Vec3, rpy: tuple[float, ...]) -> Origin:
    if not any(rpy):
        return Origin(position)
    roll, pitch, yaw = rpy
    return Origin(position, from_rpy(roll, pitch, yaw))


def _normalize_quaternion(turn: tuple[float, ...], where: str) -> tuple[float, float, float, float]:
    length = math.hypot(*turn)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}, pose: quaternion {turn} has no direction; write x y z w of length 1",
            slug="sdf.pose",
        )
    x, y, z, w = (np.array(turn) / length).tolist()
    return (x, y, z, w)
