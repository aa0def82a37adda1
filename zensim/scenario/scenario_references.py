"""Checks across the keys of a scenario: names, selectors, files, and values that must agree."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from string import Formatter
from typing import Any

import msgspec

from zensim.proto.names import NAME_PATTERN, InvalidName, check_namespace
from zensim.scenario.quantities import Draw, PlainValue
from zensim.scenario.recorded_commands import read_commands
from zensim.scenario.robot_places import ScenarioRobot, name_group, place_group, read_pose_file
from zensim.scenario.robot_selectors import SelectorInvalid, select_robots
from zensim.scenario.scenario_nodes import Issue, Place, ScenarioInvalid, ScenarioNode
from zensim.scenario.scenario_variations import VariationReader, Variations
from zensim.sim_server.description.builtin_models import list_builtin_models, list_builtin_worlds

MODEL_SUFFIXES = (".urdf", ".xacro", ".sdf", ".xml")
RECORD_WORDS = ("name", "seed")
Entry = Mapping[str, Any]


class ReferenceCheck:
    """The checks of one file; what is None in the plain values was refused before."""

    def __init__(
        self, root: ScenarioNode, plain: Entry, places: Mapping[str, Place], seed: int
    ) -> None:
        self.issues: list[Issue] = []
        self.robots: list[ScenarioRobot] = []
        self.variations = Variations()
        self._root = root
        self._plain = plain
        self._places = places
        self._seed = seed
        self._names: list[str] = []
        self._listed: dict[tuple[str, ...], dict[str, None]] = {}
        self._valid: set[str] = set()
        """Selectors that select something."""

    def run(self) -> None:
        """Check everything; mistakes are added to `issues`."""
        self._check_world()
        for index, group in self._list_entries("robots"):
            self._place_group(index, group)
        self._names = [robot.name for robot in self.robots]
        self._check_names()
        for section in ("agents", "behaviours", "faults", "checks"):
            key = "drives" if section == "agents" else "robots"
            for index, entry in self._list_entries(section):
                self._check_selector(f"{section}[{index}].{key}", entry.get(key))
                self._check_call(f"{section}[{index}].call", entry.get("call"))
        for index, entry in self._list_entries("behaviours"):
            self._check_behaviour(f"behaviours[{index}]", entry)
        for index, entry in self._list_entries("faults"):
            self._check_fault(f"faults[{index}]", entry)
        for index, entry in self._list_entries("checks"):
            self._check_check(f"checks[{index}]", entry)
        self._check_cycles()
        self._check_end()
        self._check_record()
        self._check_variations()

    def _refuse(self, path: str, message: str) -> None:
        place = self._places.get(path)
        parent = path
        while place is None and parent:
            parent = parent[: max(parent.rfind("."), parent.rfind("["), 0)]
            place = self._places.get(parent)
        self.issues.append(Issue(place or self._root.place, path, message))

    def _list_entries(self, section: str) -> Iterator[tuple[int, Entry]]:
        for index, entry in enumerate(self._plain.get(section) or ()):
            if isinstance(entry, Mapping):
                yield index, entry

    def _list_names(self, *sections: str) -> Collection[str]:
        """List the names of entries, in the order of the file; found once."""
        if (found := self._listed.get(sections)) is None:
            found = self._listed[sections] = dict.fromkeys(
                str(entry["name"])
                for section in sections
                for _, entry in self._list_entries(section)
                if entry.get("name")
            )
        return found

    def _resolve(self, path: str, word: str) -> Path:
        """Find a file that a value names, from the folder of the file with the value."""
        place = self._places.get(path)
        folder = Path(place.file).parent if place is not None and place.line else Path()
        return folder / word

    def _check_world(self) -> None:
        word = (self._plain.get("world") or {}).get("load")
        if not word or word in list_builtin_worlds():
            return
        if not _is_file(self._resolve("world.load", word)):
            worlds = ", ".join(list_builtin_worlds())
            self._refuse("world.load", f"`{word}` is no file and no shipped world; one of {worlds}")

    def _place_group(self, index: int, group: Entry) -> None:
        path = f"robots[{index}]"
        self._check_model(f"{path}.model", group.get("model"))
        if group.get("layout") and group.get("poses"):
            self._refuse(f"{path}.poses", "`layout` and `poses` exclude each other; remove one")
            return
        try:
            poses = self._read_poses(f"{path}.poses", group.get("poses"))
            if poses and group.get("count") not in (None, len(poses)):
                mistake = f"there are {len(poses)} poses, but `count` is {group['count']}"
                self._refuse(f"{path}.count", mistake)
            elif group.get("name"):
                self.robots += place_group(group, index, self._seed, poses)
        except ScenarioInvalid as error:
            self.issues += error.issues
        except (msgspec.ValidationError, TypeError, KeyError):
            # A value was refused before; the names alone are needed for selectors.
            self.robots += [
                ScenarioRobot(name, index, 0.0, 0.0)
                for name in name_group(group, group.get("count") or 1)
            ]
        except ValueError as error:
            self._refuse(f"{path}.layout", str(error))

    def _check_model(self, path: str, word: str | None) -> None:
        if not word or word in list_builtin_models() or _is_file(self._resolve(path, word)):
            return
        models = ", ".join(list_builtin_models())
        kind = "no file" if word.endswith(MODEL_SUFFIXES) or "/" in word else "no shipped model"
        self._refuse(path, f"`{word}` is {kind}; a path, or one of {models}")

    def _read_poses(self, path: str, given: object) -> list[dict[str, Any]]:
        if isinstance(given, str):
            place = self._places.get(path, self._root.place)
            return read_pose_file(self._resolve(path, given), place, path)
        return [one for one in given if one] if isinstance(given, list) else []

    def _check_names(self) -> None:
        for robot in self.robots:
            if not NAME_PATTERN.fullmatch(robot.name):
                self._refuse(f"robots[{robot.group}]", f"`{robot.name}` is no name of a robot")
        repeated = [name for name, count in Counter(self._names).items() if count > 1]
        for name in repeated:
            last = [robot for robot in self.robots if robot.name == name][-1]
            self._refuse(f"robots[{last.group}].name", f"a second robot would be `{name}`")
        self._check_namespaces()
        for sections in (("agents",), ("behaviours", "faults"), ("checks",)):
            seen: set[str] = set()
            for section in sections:
                for index, entry in self._list_entries(section):
                    if entry.get("name") in seen:
                        path = f"{section}[{index}].name"
                        self._refuse(path, f"the name `{entry['name']}` is given twice")
                    seen.add(str(entry.get("name")))

    def _check_namespaces(self) -> None:
        groups = dict(self._list_entries("robots"))
        given = {index: group.get("namespace") for index, group in groups.items()}
        taken = {robot.name for robot in self.robots if not given.get(robot.group)}
        for index, namespace in given.items():
            if not namespace:
                continue
            path = f"robots[{index}].namespace"
            try:
                bare = check_namespace(namespace)
            except InvalidName as error:
                self._refuse(path, str(error))
                continue
            if bare in taken:
                self._refuse(path, f"`{bare}` is the namespace of another robot")
            taken.add(bare)

    def _check_selector(self, path: str, selector: PlainValue) -> None:
        if selector is None or (isinstance(selector, list) and None in selector):
            return
        if isinstance(selector, str) and selector in self._valid:
            return
        if selector == "*" and path not in self._places:
            return
        try:
            select_robots(selector, self._names)
        except SelectorInvalid as error:
            self._refuse(path, str(error))
            return
        if isinstance(selector, str):
            self._valid.add(selector)

    def _require(self, path: str, word: object, known: Collection[str], what: str) -> None:
        if word and word not in known:
            listed = ", ".join(known) or "there are none"
            self._refuse(path, f"there is no {what} `{word}`; known: {listed}")

    def _check_behaviour(self, path: str, entry: Entry) -> None:
        self._require(f"{path}.target", entry.get("target"), self._names, "robot")
        target, robots = entry.get("target"), entry.get("robots")
        if target and robots and target in self._check_quietly(robots):
            self._refuse(
                f"{path}.target", f"`{target}` cannot follow itself; take it from `robots`"
            )
        if word := entry.get("file"):
            self._check_file(f"{path}.file", word, has_orders=entry.get("do") == "orders")
        if entry.get("radius") == 0.0:
            self._refuse(f"{path}.radius", "`0` is no radius of a circle; use another number")

    def _check_file(self, path: str, word: str, *, has_orders: bool) -> None:
        # Most scenarios have no orders.
        from zensim.scenario.fleet_orders import read_orders  # noqa: PLC0415

        read = read_orders if has_orders else read_commands
        try:
            read(self._resolve(path, word), self._names)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            self._refuse(path, f"`{word}`: {reason}")

    def _check_call(self, path: str, call: str | None) -> None:
        """Refuse a module that is not there; nothing is imported."""
        if not call:
            return
        top, _, inner = call.partition(":")[0].partition(".")
        folder = str(Path(self._root.place.file).resolve().parent)
        spec = PathFinder.find_spec(top, [folder]) or find_spec(top)
        if spec is None or (inner and spec.submodule_search_locations is None):
            self._refuse(path, f"`{call}`: there is no such module beside the file or on sys.path")

    def _check_fault(self, path: str, entry: Entry) -> None:
        if "at" in entry and "when" in entry:
            self._refuse(f"{path}.when", "`at` and `when` exclude each other; remove one")
        if "at" not in entry and "when" not in entry:
            self._refuse(path, "`at` or `when` is missing: when does it start?")
        near = (entry.get("when") or {}).get("near") or ()
        for index, name in enumerate(near):
            self._require(f"{path}.when.near[{index}]", name, self._names, "robot")
        if near and near[0] and near[0] == near[1]:
            self._refuse(f"{path}.when.near", f"`{near[0]}` is always near itself; name two robots")
        agents = self._list_names("agents") or ("pool",)
        self._require(f"{path}.agent", entry.get("agent"), agents, "agent")
        every, length = entry.get("every"), entry.get("for")
        is_instant = entry.get("do") == "kidnap"
        if is_instant and length is not None and every is None:
            self._refuse(f"{path}.for", "has no effect on kidnap, which is over at once; remove it")
        is_fixed = isinstance(every, float) and not isinstance(length, Draw)
        if is_fixed and not is_instant and (length is None or length >= every):
            self._refuse(f"{path}.every", "`for` must be given and shorter than `every`")

    def _check_check(self, path: str, entry: Entry) -> None:
        events = self._list_names("behaviours", "faults")
        for key in ("after", "until", "except", "event"):
            self._require(f"{path}.{key}", entry.get(key), events, "fault or behaviour")
        for index, name in enumerate(entry.get("checks") or ()):
            self._require(f"{path}.checks[{index}]", name, self._list_names("checks"), "check")
        for mistake, at_key in _find_time_mistakes(entry):
            self._refuse(f"{path}.{at_key}" if at_key else path, mistake)
        kind = entry.get("that")
        if kind in ("distance", "speed", "rate") and "above" not in entry and "below" not in entry:
            self._refuse(path, "`above` or `below` is missing: what is the limit?")
        if kind == "distance" and len(self._check_quietly(entry.get("robots", "*"))) == 1:
            self._refuse(f"{path}.robots", "a distance needs at least two robots")

    def _check_cycles(self) -> None:
        parts = {
            str(entry.get("name")): filter(None, entry.get("checks") or ())
            for _, entry in self._list_entries("checks")
        }
        try:
            TopologicalSorter(parts).prepare()
        except CycleError as error:
            cycle = error.args[1][::-1]
            index = min(
                at for at, entry in self._list_entries("checks") if entry.get("name") in cycle
            )
            mistake = f"a check cannot contain itself: {' contains '.join(cycle)}"
            self._refuse(f"checks[{index}].checks", mistake)

    def _check_quietly(self, selector: PlainValue) -> list[str]:
        try:
            return select_robots(selector or "*", self._names)
        except (SelectorInvalid, TypeError):
            return []

    def _check_end(self) -> None:
        when = (self._plain.get("end") or {}).get("when")
        if when is not None and all(names == [] for names in when.values()):
            self._refuse("end.when", "names no check; write {all: [...]}, or remove it")
        when = when or {}
        for key in ("all", "any"):
            for index, name in enumerate(when.get(key) or ()):
                path = f"end.when.{key}[{index}]"
                self._require(path, name, self._list_names("checks"), "check")

    def _check_record(self) -> None:
        word = (self._plain.get("record") or {}).get("to")
        try:
            fields = [name for _, name, _, _ in Formatter().parse(word or "") if name is not None]
        except ValueError as error:
            self._refuse("record.to", f"`{word}`: {error}")
            return
        for name in fields:
            if name not in RECORD_WORDS:
                self._refuse("record.to", f"`{{{name}}}` is not known; one of {{name}}, {{seed}}")

    def _check_variations(self) -> None:
        reader = VariationReader(self._root, self._plain)
        self.variations = reader.read()
        self.issues += reader.issues


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        # A name that is too long, or has characters that no file has.
        return False


def _find_time_mistakes(entry: Entry) -> Iterator[tuple[str, str]]:
    """Find keys of time that do not fit together, each with its key."""
    if "within" in entry and "after" not in entry:
        yield "`within` needs `after`; for a time of the run use `by`", "within"
    if "by" in entry and "after" in entry:
        yield "`by` and `after` exclude each other; use `within` beside `after`", "by"
    start, end = entry.get("from", 0.0), entry.get("by", entry.get("to"))
    key = "by" if "by" in entry else "to"
    if isinstance(start, float) and isinstance(end, float) and end <= start:
        yield f"`{key}` is not after `from` ({start:g} s)", key
    if entry.get("that") == "reached" and "by" not in entry and "within" not in entry:
        yield "`by`, or `after` and `within`, is missing: until when is the point reached?", ""
    if entry.get("hold") and "by" not in entry and "within" not in entry:
        yield "`hold` needs `by`, or `after` and `within`", "hold"
