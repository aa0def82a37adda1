"""Drives as words, as in `diff:left_joint,right_joint,0.4,0.1`: parse and write them."""

from typing import get_args

import msgspec

from zensim.proto.messages.drive_messages import DriveKind, DriveOrder

DRIVE_KINDS = tuple(kind for kind in get_args(DriveKind) if kind)
LENGTHS = ("separation_m", "diameter_m", "wheelbase_m")
"""Numbers after the joints, in this order."""


def parse_drive_order(text: str) -> DriveOrder:
    """Parse `KIND:JOINTS[,separation,diameter,wheelbase]`; empty = the drive of the description.

    Joints are separated by commas; `diff` takes left and right ones, several joined by `+`.

    Raises:
        ValueError: The kind is unknown, or a name follows a number.
    """
    kind, _, rest = text.partition(":")
    if not text:
        return DriveOrder()
    if kind not in DRIVE_KINDS:
        raise ValueError(f"`drive` {text[:80]!r}: use one of {', '.join(DRIVE_KINDS)}")
    words = [word.strip() for word in rest.split(",") if word.strip()]
    lengths = [number for word in words if (number := _parse_length(word)) is not None]
    names = words[: len(words) - len(lengths)]
    if any(_parse_length(name) is not None for name in names) or len(lengths) > len(LENGTHS):
        raise ValueError(
            f"`drive` {text[:80]!r}: write joints first, then at most separation, diameter and "
            r"wheelbase \[m]"
        )
    order = DriveOrder(kind, _split_joints(kind, names))  # type: ignore[arg-type]
    return msgspec.structs.replace(order, **dict(zip(LENGTHS, lengths, strict=False)))


def _parse_length(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _split_joints(kind: str, names: list[str]) -> tuple[str, ...]:
    sides = [name.split("+") for name in names]
    if kind != "diff":
        return tuple(joint for side in sides for joint in side)
    if len(sides) == 2 and len(sides[0]) == len(sides[1]):  # noqa: PLR2004 - left and right
        return tuple(joint for pair in zip(*sides, strict=True) for joint in pair)
    raise ValueError("`drive` diff: write as many left as right joints, as in diff:l1+l2,r1+r2")


def format_drive_order(order: DriveOrder) -> str:
    """Write a drive as `parse_drive_order` reads it."""
    names = list(order.joints)
    if order.kind == "diff":
        names = ["+".join(order.joints[::2]), "+".join(order.joints[1::2])]
    lengths = [getattr(order, name) for name in LENGTHS]
    while lengths and not lengths[-1]:
        lengths.pop()
    words = [*names, *(f"{length:g}" for length in lengths)]
    return f"{order.kind}:{','.join(words)}" if words else order.kind
