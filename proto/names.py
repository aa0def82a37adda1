"""Validation of entity names, namespaces, agent names, world names and frame ids."""

import re

NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
FRAME_PATTERN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]{0,255}")
RESERVED_NAMES = frozenset({"sim", "world"})
MAX_NAMESPACE_CHUNKS = 8
MAX_NAMESPACE_LENGTH = 200
"""ROS 2 limits topic names to 247 characters; the rest is for the topic."""
MAX_SHOWN = 80
"""Characters of an invalid name that an error message quotes."""


TOPIC_NAME = re.compile(r"/*[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*/?")
MAX_TOPIC_LENGTH = 255


class InvalidName(ValueError):
    """A name that is not valid in key expressions and in ROS 2."""


def check_name(name: str, what: str = "name") -> str:
    """Return the name if it is valid.

    Raises:
        InvalidName: Not `[A-Za-z][A-Za-z0-9_]{0,63}`.
    """
    if NAME_PATTERN.fullmatch(name):
        return name
    raise InvalidName(
        f"{what} {_abbreviate(name)} is not valid; use a letter, then up to 63 letters, digits "
        "or '_'"
    )


def check_namespace(namespace: str) -> str:
    """Return the namespace without a leading slash.

    Raises:
        InvalidName: A chunk is not a name, there are more than 8 chunks or 200 characters, or the
            first chunk is reserved.
    """
    bare = namespace.removeprefix("/")
    chunks = bare.split("/")
    if (
        not all(NAME_PATTERN.fullmatch(chunk) for chunk in chunks)
        or len(chunks) > MAX_NAMESPACE_CHUNKS
    ):
        raise InvalidName(
            f"namespace {_abbreviate(namespace)} is not valid; use names joined by '/', "
            "as 'team/r1'"
        )
    if len(bare) > MAX_NAMESPACE_LENGTH:
        raise InvalidName(
            f"namespace {_abbreviate(namespace)} has {len(bare)} characters; use at most "
            f"{MAX_NAMESPACE_LENGTH}, since ROS 2 refuses longer topics"
        )
    if chunks[0] in RESERVED_NAMES:
        raise InvalidName(
            f"namespace {_abbreviate(namespace)} begins with a reserved name; use any but 'sim', "
            "'world'"
        )
    return bare


def is_topic_name(name: str) -> bool:
    """Whether a name can be that of a topic of ROS 2; others may be wildcards of keys."""
    return len(name) <= MAX_TOPIC_LENGTH and TOPIC_NAME.fullmatch(name) is not None


def check_frame(frame_id: str) -> str:
    """Return the frame_id if it is valid in tf: no leading slash, no spaces.

    Raises:
        InvalidName: It has other characters or more than 256.
    """
    if FRAME_PATTERN.fullmatch(frame_id):
        return frame_id
    raise InvalidName(
        f"frame_id {_abbreviate(frame_id)} is not valid; use letters, digits, '_', '.', '-' or '/'"
    )


def _abbreviate(text: str) -> str:
    return repr(text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "...")
