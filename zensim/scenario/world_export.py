"""Writes the entities of a running world as a scenario file, which starts an equal world."""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import msgspec

from zensim.api.api_errors import Invalid
from zensim.api.simulation import Simulation, fetch_models
from zensim.api.world_access import api_errors
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.proto.messages.world_messages import GetCurrentWorldRequest
from zensim.proto.service_catalog import GET_CURRENT_WORLD
from zensim.scenario.scenario_format import FORMAT_VERSION
from zensim.scenario.scenario_reader import SUFFIXES, name_of_file
from zensim.sim_server.description.builtin_models import list_builtin_models, read_builtin_model

PLAIN_NUMBERS = 3
"""Decimals of rates that are written if they stand for the same step."""
Entry = Mapping[str, object]


class WorldExport(msgspec.Struct, frozen=True):
    """A scenario and the files that it names, by their names."""

    scenario: str
    files: Mapping[str, str]

    def write(self, file: Path) -> None:
        """Write the scenario, and beside it the files.

        Raises:
            OSError: One cannot be written.
        """
        for name, text in self.files.items():
            (file.parent / name).write_text(text, encoding="utf-8")
        file.write_text(self.scenario, encoding="utf-8")


def export(sim: Simulation, file: str | Path, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write a world as a scenario file, with all that was spawned at its present pose.

    `zensim.load(file)` and `zensim up FILE` start an equal world. Joints and velocities are not
    part of it.

    Args:
        sim: On a server, or in this process.
        file: `NAME.scenario.yaml`; descriptions that are not shipped become files beside it.
        overwrite: Whether files that exist are replaced.

    Returns:
        The files written, the scenario first.

    Raises:
        Invalid: The name has another suffix, or a file exists.
        NotFound: There is no such folder.
    """
    file = Path(file)
    if not file.name.endswith(SUFFIXES):
        raise Invalid(f"'{file.name}' does not end in {SUFFIXES[0]}", hint="add it")
    found = export_world(sim, name_of_file(str(file)))
    written = tuple(file.parent / name for name in (file.name, *found.files))
    exist = [one.name for one in written if one.exists()]
    if exist and not overwrite:
        raise Invalid(
            f"{', '.join(exist)} exists",
            slug="file_exists",
            hint="use another name, or overwrite=True (`force`)",
        )
    with api_errors():
        found.write(file)
    return written


def export_world(sim: Simulation, stem: str) -> WorldExport:
    """Describe the present world: its file, engine, rates, seed, and all that was spawned.

    Poses are those of now; joints and velocities are not part of a scenario. Descriptions other
    than shipped models become files named after `stem`.
    """
    files: dict[str, str] = {}
    world = _describe_world(sim, stem, files)
    info = sim.info
    scenario: dict[str, object] = {
        "zensim": FORMAT_VERSION,
        "name": stem,
        "world": world | {"name": info.world},
        "engine": {
            "use": info.engine,
            "step_rate": _find_rate(info.step_ns),
            "control_rate": _find_rate(round(sim.control_period * NANOSECONDS)),
        },
        "time": {"mode": "lockstep" if info.is_lockstep else "free", "seed": info.seed},
    }
    if robots := list(_describe_robots(sim, stem, files)):
        scenario["robots"] = robots
    return WorldExport("".join(f"{line}\n" for line in _write_lines(scenario)), files)


def _write_lines(scenario: Entry) -> Iterator[str]:
    """Write a map as YAML whose values are JSON, with a line for each pose."""
    for key, value in scenario.items():
        if not isinstance(value, list):
            yield f"{key}: {json.dumps(value, ensure_ascii=False)}"
            continue
        yield f"{key}:"
        for entry in value:
            rest = {word: one for word, one in entry.items() if word != "poses"}
            yield f'  - {json.dumps(rest, ensure_ascii=False)[:-1]}, "poses": ['
            yield ",\n".join(f"      {json.dumps(one)}" for one in entry["poses"])
            yield "    ]}"


def _describe_world(sim: Simulation, stem: str, files: dict[str, str]) -> dict[str, object]:
    found = sim.call(GET_CURRENT_WORLD, GetCurrentWorldRequest()).world
    resource = found.world_resource
    if resource.resource_string:
        name = f"{stem}.world.sdf"
        files[name] = resource.resource_string
        return {"load": name}
    return {"load": resource.uri or found.name or "empty"}


def _find_rate(period_ns: int) -> float:
    """Find the rate [Hz] of a period, with few decimals if that is the same period."""
    exact = NANOSECONDS / period_ns
    short = round(exact, PLAIN_NUMBERS)
    return short if short and round(NANOSECONDS / short) == period_ns else exact


def _describe_robots(sim: Simulation, stem: str, files: dict[str, str]) -> Iterator[Entry]:
    response = fetch_models(sim, wants_descriptions=True)
    spawned = [one for one in response.entities if not one.belongs_to_world]
    if not spawned:
        return
    poses = dict(zip([one.entity for one in spawned], _read_poses(sim, spawned), strict=True))
    models = _name_models(response.descriptions, spawned, stem, files)
    taken: set[str] = set()

    def key(one: EntityModel) -> tuple[int, str]:
        # A namespace of its own belongs to an entry of its own.
        return one.description, "" if one.namespace == one.entity else one.entity

    for (number, _), group in groupby(spawned, key):
        entities = list(group)
        entry: dict[str, object] = {"name": _name_group(entities, taken), "model": models[number]}
        if entities[0].namespace != entities[0].entity:
            entry["namespace"] = entities[0].namespace
        drive = getattr(response.models[entities[0].model], "drive", None)
        if drive is None and not any(one.agent for one in entities):
            entry["agent"] = "none"
        entry["poses"] = [{"name": one.entity, **poses[one.entity]} for one in entities]
        yield entry


def _read_poses(sim: Simulation, spawned: Sequence[EntityModel]) -> Iterator[dict[str, float]]:
    for row in sim.fleet([one.entity for one in spawned]).poses().tolist():
        roll, pitch, yaw = _find_angles(*row[3:7])
        named = dict(zip(("x", "y", "z"), row[:3], strict=True))
        turned = {"roll": roll, "pitch": pitch, "yaw": yaw}
        yield named | {name: angle for name, angle in turned.items() if angle}


def _find_angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Find roll, pitch and yaw [rad], fixed axes, of a unit quaternion."""
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, math.asin(sine), yaw


def _name_models(
    texts: Sequence[str], spawned: Sequence[EntityModel], stem: str, files: dict[str, str]
) -> dict[int, str]:
    """Name the model of each description: that of a shipped one, or a file with its text."""
    shipped = {read_builtin_model(name): name for name in list_builtin_models()}
    names = {}
    for number in dict.fromkeys(one.description for one in spawned):
        text = texts[number]
        if text not in shipped:
            kind = "sdf" if re.search(r"<sdf[\s>]", text) else "urdf"
            name = f"{stem}.model{len(files)}.{kind}"
            files[name] = text
            names[number] = name
        else:
            names[number] = shipped[text]
    return names


def _name_group(entities: Sequence[EntityModel], taken: set[str]) -> str:
    """Name a group after its first entity, without its number."""
    first = re.sub(r"[^A-Za-z0-9_]", "_", entities[0].entity)
    stem = (first.rstrip("0123456789") if len(entities) > 1 else first) or "robot"
    stem = stem if stem[0].isalpha() else f"r{stem}"
    name, number = stem, 1
    while name in taken:
        number += 1
        name = f"{stem}_{number}"
    taken.add(name)
    return name
