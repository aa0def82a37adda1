"""The wire for programs in other languages: schemas, services, keys, codes and golden bytes.

`python -m proto.schema` writes them to `proto/schemas/`; with `--check` it only compares.
"""

import inspect
import json
import sys
from enum import IntEnum
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import msgspec

from zensim.proto import (
    assets,
    claims,
    drives,
    entities,
    fleets,
    gazebo,
    geometry,
    header,
    info,
    keys,
    model,
    places,
    result,
    scene,
    services,
    stepping,
    telemetry,
    topics,
    worlds,
)
from zensim.proto.catalog import SERVICES
from zensim.proto.codec import Format, encode, encoding_of, offers
from zensim.proto.example import example_of

Kind = TypeVar("Kind")

SCHEMAS = Path(__file__).parent / "schemas"
MESSAGE_MODULES: tuple[ModuleType, ...] = (
    assets,
    claims,
    drives,
    entities,
    fleets,
    gazebo,
    geometry,
    header,
    info,
    model,
    places,
    result,
    scene,
    services,
    stepping,
    telemetry,
    topics,
    worlds,
)
KEY_ARGUMENTS = {
    "world": "default",
    "agent": "agent_1",
    "name": "spawn_entity",
    "namespace": "r1",
    "topic": "odom",
}
TOPICS: dict[str, tuple[type[msgspec.Struct], ...]] = {
    keys.clock("default"): (telemetry.WorldClock,),
    keys.stats("default"): (telemetry.Stats,),
    keys.snapshot("default"): (telemetry.Snapshot,),
    keys.events("default"): (telemetry.Event,),
    keys.model_states("default"): (gazebo.ModelStates,),
    keys.link_states("default"): (gazebo.LinkStates,),
    keys.steps_progress("default"): (stepping.StepsProgress,),
    keys.drive_state("default", "agent_1"): (claims.DriveState,),
    keys.drive_command("default", "agent_1"): (claims.DriveCommand,),
    keys.robot("r1", keys.CMD_VEL): (geometry.Twist, geometry.TwistStamped),
    keys.robot("r1", keys.ODOM): (topics.Odometry,),
    keys.robot("r1", keys.TF): (topics.TFMessage,),
    keys.robot("r1", keys.TF_STATIC): (topics.TFMessage,),
    keys.robot("r1", keys.JOINT_STATES): (topics.JointState,),
    keys.robot("r1", keys.ROBOT_DESCRIPTION): (topics.String,),
}
"""What travels on each topic."""


def messages() -> dict[str, type[msgspec.Struct]]:
    """List the public messages by name."""
    return {kind.__name__: kind for kind in _defined(msgspec.Struct)}


def spoken_types() -> list[type[msgspec.Struct]]:
    """List the types that travel by themselves: on topics, as requests, as responses."""
    on_topics = {kind for kinds in TOPICS.values() for kind in kinds}
    in_services = {kind for one in SERVICES.values() for kind in (one.request, one.response)}
    return sorted(on_topics | in_services, key=lambda kind: kind.__name__)


def artefacts() -> dict[str, str]:
    """Write everything as text, by file name."""
    contents = {
        "messages.json": message_schemas(),
        "services.json": service_list(),
        "keys.json": key_list(),
        "codes.json": codes(),
        "golden.json": golden(),
    }
    return {
        name: json.dumps(content, indent=1, ensure_ascii=False) + "\n"
        for name, content in contents.items()
    }


def message_schemas() -> dict[str, object]:
    """Describe every message by JSON Schema; properties stand in the order of CDR."""
    kinds = messages()
    _, described = msgspec.json.schema_components(kinds.values())
    for name, kind in kinds.items():
        if hasattr(kind, "ros_type"):
            described[name]["x-ros-type"] = kind.ros_type
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": dict(sorted(described.items())),
    }


def service_list() -> dict[str, object]:
    """Name each service's key, messages, codes and formats."""
    return {
        name: {
            "key": keys.service("default", name),
            "request": service.request.__name__,
            "response": service.response.__name__,
            "codes": [
                family.__name__ for family in (result.ResultCode, service.codes) if [*family]
            ],
            "formats": _formats(service.request, service.response),
        }
        for name, service in sorted(SERVICES.items())
    }


def key_list() -> dict[str, object]:
    """Write each key expression with example arguments, and what travels on each topic."""
    examples = {}
    for name, function in sorted(vars(keys).items()):
        wanted = inspect.signature(function).parameters if inspect.isfunction(function) else ["-"]
        if set(wanted) <= set(KEY_ARGUMENTS):
            examples[name] = function(**{given: KEY_ARGUMENTS[given] for given in wanted})
    on_topics = {key: [kind.__name__ for kind in kinds] for key, kinds in sorted(TOPICS.items())}
    return {"arguments": KEY_ARGUMENTS, "keys": examples, "topics": on_topics}


def codes() -> dict[str, object]:
    """List every number that has a name, by enumeration."""
    return {
        family.__name__: {member.name: member.value for member in family}
        for family in _defined(IntEnum)
    }


def golden() -> dict[str, object]:
    """Write one example of each type that travels: CDR and MessagePack as hex, JSON as text."""
    return {kind.__name__: _golden(kind) for kind in spoken_types()}


def _golden(kind: type[msgspec.Struct]) -> dict[str, str]:
    example = example_of(kind)
    written = {"encoding": encoding_of(kind, Format.CDR)} if offers(kind, Format.CDR) else {}
    for name in _formats(kind):
        payload = encode(example, Format[name])
        written[name] = payload.decode() if name == Format.JSON.name else payload.hex()
    return written


def _formats(*kinds: type[msgspec.Struct]) -> list[str]:
    return [format_.name for format_ in Format if all(offers(kind, format_) for kind in kinds)]


def _defined(parent: type[Kind]) -> list[type[Kind]]:
    """List the subclasses that the message modules define, by name."""
    found = [
        member
        for module in MESSAGE_MODULES
        for member in vars(module).values()
        if isinstance(member, type)
        and issubclass(member, parent)
        and member.__module__ == module.__name__
    ]
    return sorted(found, key=lambda kind: kind.__name__)


def drifted(folder: Path = SCHEMAS) -> list[str]:
    """Name the committed files that are not what the types say now."""
    wanted = artefacts()
    present = {path.name for path in folder.glob("*.json")}
    return sorted(
        name
        for name in wanted.keys() | present
        if name not in present
        or name not in wanted
        or (folder / name).read_text(encoding="utf-8") != wanted[name]
    )


def write(folder: Path = SCHEMAS) -> None:
    """Write every artefact."""
    folder.mkdir(exist_ok=True)
    for name, text in artefacts().items():
        (folder / name).write_text(text, encoding="utf-8")


def main(arguments: list[str], folder: Path = SCHEMAS) -> int:
    """Write the artefacts, or compare them with `--check`.

    Returns:
        0; 1 when committed files differ; 2 for other arguments.
    """
    if not arguments:
        write(folder)
        return 0
    if arguments != ["--check"]:
        sys.stdout.write(f"arguments are {' '.join(arguments)}; use --check or none\n")
        return 2
    stale = drifted(folder)
    for name in stale:
        sys.stdout.write(f"{name} is stale; run 'python -m proto.schema'\n")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
