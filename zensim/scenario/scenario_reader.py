"""Reads a scenario file: all mistakes at once, each with its place, else a scenario to run."""

import gc
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from zensim.scenario.fault_sections import Fault
from zensim.scenario.quantities import Draw, resolve_draws
from zensim.scenario.robot_places import ScenarioRobot
from zensim.scenario.robot_selectors import select_robots
from zensim.scenario.scenario_format import Behaviour, PythonBehaviour, PythonCheck, ScenarioFormat
from zensim.scenario.scenario_nodes import Issue, Place, ScenarioInvalid, ScenarioNode
from zensim.scenario.scenario_references import ReferenceCheck
from zensim.scenario.scenario_sources import read_merged_nodes
from zensim.scenario.scenario_variations import Variations
from zensim.scenario.setting_sections import Selector
from zensim.scenario.typed_reading import TypedReader

SUFFIXES = (".scenario.yaml", ".scenario.yml", ".scenario.json")
SHIPPED = Path(__file__).parent / "shipped"
Section = TypeVar("Section")


class Scenario(msgspec.Struct, frozen=True):
    """A scenario that was read without mistakes."""

    file: str
    format: ScenarioFormat
    """Typed values, with the draws of the whole run."""
    robots: tuple[ScenarioRobot, ...]
    plain: Mapping[str, Any]
    """All values with their draws, SI."""
    places: Mapping[str, Place]
    """Places of all key paths."""
    variations: Variations = Variations()
    """What varies between the runs of a sweep."""

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.format.name or name_of_file(self.file)

    @property
    def seed(self) -> int:
        """Seed of the run."""
        seed: int = self.format.time.seed
        return seed

    @property
    def robot_names(self) -> list[str]:
        """Names of all robots, in the order of spawning."""
        return [robot.name for robot in self.robots]

    @property
    def sha256(self) -> str:
        """Digest of all values; equal for files that differ in form only."""
        return digest_values(self.plain)

    @property
    def has_code(self) -> bool:
        """Whether behaviours or checks are code of the file's author."""
        used = (*self.format.behaviours, *self.format.checks)
        return any(isinstance(one, PythonBehaviour | PythonCheck) for one in used)

    def find_value(self, key: str) -> Any:  # noqa: ANN401
        """Find the value of a key of a section."""
        section, _, name = key.partition(".")
        return getattr(getattr(self.format, section), name)

    def select(self, selector: Selector) -> list[str]:
        """Select robots by a selector of the file."""
        return select_robots(selector, self.robot_names)

    def find_place(self, path: str) -> Place:
        """Find the place of a key path."""
        return self.places.get(path, Place(self.file))

    def resolve_behaviour(self, index: int, robot: str) -> Behaviour:
        """Resolve the draws of a behaviour for one of its robots."""
        plain = self.plain["behaviours"][index]
        resolved = resolve_draws(plain, self.seed, f"behaviours.{plain['name']}", robot)
        found: Behaviour = msgspec.convert(resolved, Behaviour)
        return found

    def resolve_fault(self, index: int, robot: str) -> Fault:
        """Resolve the draws of a fault for one of its robots."""
        plain = self.plain["faults"][index]
        resolved = resolve_draws(plain, self.seed, f"faults.{plain['name']}", robot)
        found: Fault = msgspec.convert(resolved, Fault)
        return found

    def find_file(self, path: str, word: str) -> Path:
        """Find a file that a value names, from the folder of the file with the value."""
        return Path(self.find_place(path).file).parent / word


def name_of_file(file: str) -> str:
    """Name a file without the suffixes of scenarios."""
    name = Path(file).name
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix)
    return name.split(".", 1)[0] or "scenario"


def find_scenario_file(word: str) -> str:
    """Find a scenario by its path, or a shipped one by its name.

    Raises:
        FileNotFoundError: There is none.
    """
    if Path(word).is_file():
        return word
    shipped = SHIPPED / f"{word}{SUFFIXES[0]}"
    if "/" not in word and shipped.is_file():
        return str(shipped)
    known = ", ".join(list_shipped_scenarios())
    raise FileNotFoundError(2, f"no such file or shipped scenario ({known})", word)


def list_shipped_scenarios() -> list[str]:
    """List the names of the shipped scenarios."""
    return sorted(name_of_file(file.name) for file in SHIPPED.glob(f"*{SUFFIXES[0]}"))


def read_scenario(file: str, settings: Sequence[str] = ()) -> Scenario:
    """Read a scenario file.

    Args:
        file: Its path.
        settings: `KEY.PATH=VALUE`, which win over the file.

    Raises:
        ScenarioInvalid: With all mistakes.
    """
    with paused_collection():
        return make_scenario(file, read_merged_nodes(file, settings))


@contextmanager
def paused_collection() -> Iterator[None]:
    """Collect no garbage: nothing that is read has cycles, and looking for them takes half."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def make_scenario(file: str, root: ScenarioNode) -> Scenario:
    """Make a scenario of the nodes of a file, with all that it includes.

    Raises:
        ScenarioInvalid: With all mistakes.
    """
    reader = TypedReader()
    plain = reader.read(root, _describe_format(), "") or {}
    seed = (plain.get("time") or {}).get("seed") or 0
    check = ReferenceCheck(root, plain, reader.places, seed)
    check.run()
    issues = [*reader.issues, *check.issues]
    if issues:
        raise ScenarioInvalid(_sort_issues(issues))
    resolved = resolve_draws(plain, seed, "run") if reader.has_draws else plain
    return Scenario(
        file,
        msgspec.convert(resolved, ScenarioFormat),
        tuple(check.robots),
        plain,
        reader.places,
        check.variations,
    )


@cache
def _describe_format() -> inspect.Type:
    return inspect.type_info(ScenarioFormat)


def _sort_issues(issues: Sequence[Issue]) -> tuple[Issue, ...]:
    files = list(dict.fromkeys(issue.place.file for issue in issues))
    unique = dict.fromkeys(issues)
    return tuple(
        sorted(
            unique, key=lambda one: (files.index(one.place.file), one.place.line, one.place.column)
        )
    )


def digest_values(plain: Mapping[str, Any]) -> str:
    """Digest values of a scenario, with their draws; SHA-256 in hexadecimal digits."""
    text = json.dumps(plain, sort_keys=True, default=_encode_draw)
    return hashlib.sha256(text.encode()).hexdigest()


def _encode_draw(value: object) -> object:
    if isinstance(value, Draw):
        return {value.kind: list(value.values)}
    raise TypeError(f"{type(value).__name__} is no value of a scenario")
