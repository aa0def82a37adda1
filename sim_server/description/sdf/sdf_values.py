"""Values of SDF elements: numbers, vectors, flags, names, poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Origin, Vec3
from zensim.sim_server.description.model_geometry import make_origin
from zensim.sim_server.description.strict_parsing import parse_flag, quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

MAX_POSITION_M = 1e9
"""Doubles resolve a millimetre up to this distance."""
ROTATION_FORMATS = EULER_FORMAT, QUATERNION_FORMAT = "euler_rpy", "quat_xyzw"
MAX_NAME_LENGTH = 256
INFINITY_TEXTS = ("inf", "+inf", "-inf", "infinity", "-infinity")


class RelativePose(msgspec.Struct, frozen=True):
    """A <pose>; an empty `frame` is the default frame of its owner."""

    origin: Origin = Origin()
    frame: str = ""


def read_text(owner: Element, tag: str, default: str = "") -> str:
    """Read the text of the first child with a tag; empty gives the default."""
    return (owner.findtext(tag) or "").strip() or default


def read_vector(owner: Element, tag: str, default: Vec3, where: str) -> Vec3:
    """Read three numbers.

    Raises:
        ModelError: They are not.
    """
    numbers = read_child_numbers(owner, tag, default, where)
    x, y, z = numbers
    return (x, y, z)


def read_child_numbers(
    owner: Element, tag: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    """Read as many numbers as the default has.

    Raises:
        ModelError: They are not.
    """
    text = read_text(owner, tag)
    if not text:
        return default
    return read_numbers(text, counts=(len(default),), where=f"{where}, {tag}", slug="sdf.number")


def read_scalar(owner: Element, tag: str, default: float, where: str) -> float:
    """Read a number.

    Raises:
        ModelError: It is not.
    """
    return read_child_numbers(owner, tag, (default,), where)[0]


def read_bound(owner: Element, tag: str, default: float, where: str) -> float:
    """Read a limit, which may be infinite.

    Raises:
        ModelError: It is not a number.
    """
    text = read_text(owner, tag).lower()
    return float(text) if text in INFINITY_TEXTS else read_scalar(owner, tag, default, where)


def read_flag(owner: Element, tag: str, *, default: bool, where: str) -> bool:
    """Read true, false, 1 or 0; an empty element is false.

    Raises:
        ModelError: It is none of these.
    """
    found = owner.find(tag)
    if found is None:
        return default
    text = (found.text or "").strip() or "false"
    flag = parse_flag(text)
    if flag is None:
        raise ModelError(
            f"{where}, {tag}: {quote(text)} is not a flag; write true or false", slug="sdf.flag"
        )
    return flag


def read_name(element: Element, where: str) -> str:
    """Read the name of an element.

    Raises:
        ModelError: It is missing, too long, not printable or reserved.
    """
    name = (element.get("name") or "").strip()
    if not name or len(name) > MAX_NAME_LENGTH or not name.isprintable():
        raise ModelError(
            f"{where}: invalid name {quote(name)}; use 1 to {MAX_NAME_LENGTH} printable characters",
            slug="sdf.name",
        )
    if name == "world" or (name.startswith("__") and name.endswith("__")):
        raise ModelError(
            f"{where}: name {quote(name)} is reserved by SDF; choose another", slug="sdf.name"
        )
    return name


def read_pose(owner: Element, where: str) -> RelativePose:
    """Read the <pose> of an element; identity without one.

    Raises:
        ModelError: Not six or seven numbers, or too far away.
    """
    pose = owner.find("pose")
    if pose is None:
        return RelativePose()
    frame = (pose.get("relative_to") or pose.get("frame") or "").strip()
    format_ = pose.get("rotation_format") or EULER_FORMAT
    if format_ not in ROTATION_FORMATS:
        raise ModelError(
            f"{where}, pose: rotation_format {quote(format_)} is unknown; "
            f"use {' or '.join(ROTATION_FORMATS)}",
            slug="sdf.pose",
        )
    if not (pose.text or "").strip():
        return RelativePose(frame=frame)
    is_quaternion = format_ == QUATERNION_FORMAT
    numbers = read_numbers(
        pose.text, counts=(7,) if is_quaternion else (6,), where=f"{where}, pose", slug="sdf.pose"
    )
    x, y, z = numbers[:3]
    if max(map(abs, (x, y, z))) > MAX_POSITION_M:
        raise ModelError(
            f"{where}, pose: {quote(pose.text)} is too far away; use at most {MAX_POSITION_M:g} m",
            slug="sdf.pose",
        )
    turn = numbers[3:]
    if is_quaternion:
        return RelativePose(Origin((x, y, z), _normalize_quaternion(turn, where)), frame)
    if parse_flag(pose.get("degrees")):
        turn = tuple(map(math.radians, turn))
    return RelativePose(make_origin((x, y, z), turn), frame)


def _normalize_quaternion(turn: tuple[float, ...], where: str) -> tuple[float, float, float, float]:
    length = math.hypot(*turn)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}, pose: quaternion {turn} has length 0; write x y z w of length 1",
            slug="sdf.pose",
        )
    x, y, z, w = (np.array(turn) / length).tolist()
    return (x, y, z, w)
