"""What the options of `zensim spawn` ask for, once they have been checked."""

import os
import sys
from pathlib import Path
from typing import get_args

import msgspec

from zensim.proto.bus import Bus
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Header, PoseStamped
from zensim.proto.names import check_name, check_namespace
from zensim.spawner.cli.options import Reading, SpawnOptions
from zensim.spawner.descriptions import (
    Description,
    from_database,
    from_file,
    from_stream,
    from_topic,
    from_word,
    with_model_uris,
)
from zensim.spawner.expansion import arguments_of
from zensim.spawner.launch import pose_at
from zensim.spawner.search_paths import SearchPaths, search_paths

COMPATS: tuple[Compat, ...] = get_args(Compat)
DYNAMICS: tuple[Dynamics, ...] = get_args(Dynamics)
STDIN = "-"
TRUE_WORDS, FALSE_WORDS = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}


class Source(msgspec.Struct, frozen=True):
    """The one place that a description comes from."""

    kind: str
    word: str = ""


def source_of(given: SpawnOptions) -> Source:
    """Tell where the description comes from.

    Raises:
        ValueError: From nowhere, or from two places.
    """
    named = {
        "MODEL": given.model,
        "-urdf": given.urdf,
        "-file": given.file,
        "-topic": given.topic,
        "-database": given.database,
        "-stdin": STDIN if given.stdin else "",
    }
    sources = [Source(kind, word) for kind, word in named.items() if word]
    if len(sources) == 1:
        return sources[0]
    if sources:
        kinds = " and ".join(source.kind for source in sources)
        raise ValueError(f"{kinds} exclude one another; give one")
    raise ValueError(
        "no model was given; use 'zensim spawn box_bot', a path of a URDF or SDF file, "
        "-file, -topic, -database or -stdin"
    )


def paths_of(given: Reading) -> SearchPaths:
    """Collect where to look for files.

    Raises:
        NotADirectoryError: A --package-path is no folder.
    """
    named = given.package_path or []
    for path in named:
        if not path.is_dir():
            raise NotADirectoryError(20, "--package-path is no folder", str(path))
    return search_paths(named, os.environ)


def description_here(source: Source, given: Reading, paths: SearchPaths) -> Description:
    """Read a description on this host; empty when it comes from the network.

    Raises:
        OSError: There is no such file.
        ValueError: It cannot be read.
    """
    arguments = arguments_of(given.xacro_arg or ())
    if source.kind == "-topic":
        return Description()
    if source.word == STDIN and source.kind in ("-stdin", "MODEL", "FILE"):
        found = from_stream(sys.stdin.buffer, arguments, paths)
    elif source.kind == "-database":
        found = from_database(source.word, arguments, paths)
    elif source.kind == "-file":
        found = from_file(Path(source.word), arguments, paths)
    else:
        found = from_word(source.word, arguments, paths)
    return with_model_uris(found) if given.package_to_model else found


def order_of(given: SpawnOptions) -> SpawnEntityOrder:
    """Put the options into an order that lacks the description.

    Raises:
        ValueError: One cannot be had.
    """
    if given.joint != ("", ""):
        raise ValueError(
            f"-J {given.joint[0]} {given.joint[1]}: initial joint positions are not supported, "
            "nor are they by Gazebo; leave -J out"
        )
    name = given.name or given.entity
    frame = given.reference_frame or given.frame
    pose = pose_at((given.x, given.y, given.z or 0.0), (given.roll, given.pitch, given.yaw))
    return SpawnEntityOrder(
        check_name(name) if name else "",
        allow_renaming=given.allow_renaming or not name,
        entity_namespace=namespace_of(given),
        initial_pose=PoseStamped(Header(frame_id=frame), pose),
        snap_to_ground=given.z is None or given.snap_to_ground,
        dry_run=given.dry_run,
        strict=given.strict,
        allow_missing=given.allow_missing,
        compat=compat_of(given),
        dynamics=dynamics_of(given.dynamics),
    )


def compat_of(given: Reading) -> Compat:
    """Read `--compat`.

    Raises:
        ValueError: It is none.
    """
    for known in COMPATS:
        if given.compat == known:
            return known
    raise ValueError(f"--compat {given.compat[:40]!r} is unknown; use {' or '.join(COMPATS)}")


def dynamics_of(word: str) -> Dynamics:
    """Read `--dynamics`; empty = as the world is.

    Raises:
        ValueError: It is none.
    """
    for known in DYNAMICS:
        if word == known:
            return known
    kinds = ", ".join(known for known in DYNAMICS if known)
    raise ValueError(f"--dynamics {word[:40]!r} is unknown; use {kinds}")


def namespace_of(given: SpawnOptions) -> str:
    """Read `--namespace`: the tutorial's switch, or a namespace by itself.

    Raises:
        InvalidName: It is none.
    """
    named = given.robot_namespace or given.gazebo_robot_namespace
    word = given.namespace.lower()
    if word in FALSE_WORDS:
        return ""
    space = named if word in TRUE_WORDS or not word else given.namespace
    return check_namespace(space) if space else ""


def description_there(
    bus: Bus, source: Source, given: SpawnOptions, timeout_s: float
) -> Description:
    """Read a description from the network.

    Raises:
        TimeoutError: None came.
        ValueError: What came is none.
    """
    found = from_topic(bus, source.word, timeout_s)
    return with_model_uris(found) if given.package_to_model else found
