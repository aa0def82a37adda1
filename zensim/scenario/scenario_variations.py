"""Variations of a scenario: its `vary` section as values, and their combinations."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import cos, isfinite, log, pi, sqrt
from typing import Any

import msgspec
from msgspec import inspect

from zensim.scenario.quantities import DRAW_KINDS, PAIRS, Draw, PlainValue, can_draw, make_uniforms
from zensim.scenario.scenario_format import ScenarioFormat
from zensim.scenario.scenario_nodes import Issue, Place, ScenarioNode, name_of
from zensim.scenario.scenario_sources import split_path
from zensim.scenario.typed_reading import PAIR, TypedReader, find_type

COUNTS = ("seeds", "repeats")
WORDS = (*COUNTS, "random", "list")
"""Keys of `vary` that are no key paths."""
FIXED = ("zensim", "include", "vary")
"""Keys that cannot vary."""
RANGE_KEYS = {"from", "to", "steps"}
MAX_RUNS = 100_000
DIGITS = 12
"""Significant digits of the values of a range."""

Values = Mapping[str, PlainValue]
"""Values by key path, SI."""


class RandomInput(msgspec.Struct, frozen=True):
    """A key whose value is drawn for each sample."""

    path: str
    kind: str
    """One of `DRAW_KINDS`."""
    values: tuple[Any, ...]
    is_whole: bool = False
    """Whether the key has whole numbers."""

    def draw(self, seed: int, sample: int) -> PlainValue:
        """Draw the value of a sample; other samples and keys do not change it."""
        first, second = make_uniforms(seed, f"vary.{self.path}", str(sample))
        if self.kind == "choice":
            return self.values[min(int(first * len(self.values)), len(self.values) - 1)]
        low, high = self.values
        if self.kind == "normal":
            found = low + high * sqrt(-2.0 * log(1.0 - first)) * cos(2.0 * pi * second)
            return round(found) if self.is_whole else found
        if self.is_whole:
            return low + min(int(first * (high - low + 1)), high - low)
        return low + first * (high - low)


class Variations(msgspec.Struct, frozen=True):
    """What varies between the runs of a sweep."""

    grid: tuple[tuple[str, tuple[Any, ...]], ...] = ()
    """Key paths with all their values."""
    random: tuple[RandomInput, ...] = ()
    samples: int = 1
    entries: tuple[Values, ...] = ()
    """Values that belong together."""
    seeds: int | None = None
    """Seeds of each combination; None = the seed of the file."""
    repeats: int = 1
    """Runs of each seed, which have to end in equal states."""

    @property
    def paths(self) -> list[str]:
        """Key paths that vary."""
        listed = [path for path, _ in self.grid] + [one.path for one in self.random]
        return list(dict.fromkeys([*listed, *(path for one in self.entries for path in one)]))

    @property
    def combinations(self) -> int:
        """Number of combinations of values."""
        count = self.samples * max(1, len(self.entries))
        for _, values in self.grid:
            count *= len(values)
        return count

    def combine(self, seed: int) -> Iterator[Values]:
        """Combine the values: each of the grid with each sample and each entry of the list.

        Args:
            seed: Of the random samples.
        """
        paths = [path for path, _ in self.grid]
        for chosen in product(*(values for _, values in self.grid)):
            for sample in range(self.samples):
                drawn = {one.path: one.draw(seed, sample) for one in self.random}
                for entry in self.entries or ({},):
                    yield {**dict(zip(paths, chosen, strict=True)), **drawn, **entry}


class VariationReader:
    """Reads the `vary` section of a scenario; mistakes are added to `issues`."""

    def __init__(self, root: ScenarioNode, plain: Mapping[str, Any]) -> None:
        """Prepare to read.

        Args:
            root: The whole scenario.
            plain: Its values; what is None was refused before.
        """
        self.issues: list[Issue] = []
        self._root = root
        self._plain = plain
        self._seen: dict[str, str] = {}

    def read(self) -> Variations:
        """Read the section; what is wrong is left out."""
        vary = self._root.items.get("vary")
        items = vary.items if vary is not None else {}
        grid = []
        for key, node in items.items():
            place = vary.key_places[key] if vary is not None else node.place
            if key in COUNTS:
                self._read_count(node, f"vary.{key}", place)
            elif key not in WORDS:
                grid.append((key, tuple(self._read_grid(key, node, place))))
        random, samples = self._read_random(items.get("random"))
        found = Variations(
            tuple(grid),
            random,
            samples,
            tuple(self._read_entries(items.get("list"))),
            _find_count(items.get("seeds"), None),
            _find_count(items.get("repeats"), 1) or 1,
        )
        self._check_whole(found)
        return found

    def _refuse(self, place: Place, path: str, message: str) -> None:
        self.issues.append(Issue(place, path, message))

    def _read_count(self, node: ScenarioNode, path: str, place: Place) -> None:
        if _find_count(node, None) is None:
            self._refuse(place, path, "is not a whole number >= 1")

    def _check_whole(self, found: Variations) -> None:
        place = self._root.key_places.get("vary", self._root.place)
        count = found.combinations * (found.seeds or 1) * found.repeats
        if count > MAX_RUNS:
            self._refuse(place, "vary", f"gives {count} runs; at most {MAX_RUNS}")
        if found.seeds is not None and "time.seed" in found.paths:
            self._refuse(place, "vary", "`seeds` and `time.seed` exclude each other; remove one")

    def _read_grid(self, key: str, node: ScenarioNode, place: Place) -> list[PlainValue]:
        path = f"vary.{key}"
        kind = self._find_kind(key, path, place)
        if kind is None:
            return []
        if node.is_map and RANGE_KEYS & set(node.items):
            return self._read_range(node, kind, path, place)
        if not node.elements:
            self._refuse(place, path, "is not a list of values, nor {from: …, to: …, steps: …}")
        return self._read_values(node.elements, kind, path)

    def _read_range(
        self, node: ScenarioNode, kind: inspect.Type, path: str, place: Place
    ) -> list[PlainValue]:
        if set(node.items) != RANGE_KEYS:
            self._refuse(place, path, "needs exactly the keys from, to and steps")
            return []
        steps = _find_count(node.items["steps"], None)
        if steps is None or steps > MAX_RUNS:
            self._refuse(place, path, f"`steps` is not a whole number from 1 to {MAX_RUNS}")
            return []
        ends = self._read_values([node.items["from"], node.items["to"]], kind, path)
        if not all(_is_number(one) for one in ends):
            if None not in ends:
                self._refuse(place, path, "`from` and `to` are not numbers; use a list of values")
            return []
        low, high = ends
        if not isfinite(high - low):
            self._refuse(place, path, "`to` is too far from `from`")
            return []
        share = [one / max(1, steps - 1) for one in range(steps)]
        values = [float(f"{low + one * (high - low):.{DIGITS}g}") for one in share]
        if not (isinstance(low, int) and isinstance(high, int)):
            return values
        if any(one != int(one) for one in values):
            self._refuse(place, path, f"{steps} steps give numbers that are not whole")
        return [int(one) for one in values]

    def _read_random(self, node: ScenarioNode | None) -> tuple[tuple[RandomInput, ...], int]:
        if node is None:
            return (), 1
        samples = _find_count(node.items.get("samples"), None)
        if samples is None:
            self._refuse(node.place, "vary.random.samples", "is not a whole number >= 1")
        read = (
            self._read_input(key, one, node.key_places[key])
            for key, one in node.items.items()
            if key != "samples"
        )
        found = tuple(one for one in read if one is not None)
        if not set(node.items) - {"samples"}:
            self._refuse(node.place, "vary.random", "needs a key, such as robots.cart.count")
        return found, samples or 1

    def _read_input(self, key: str, node: ScenarioNode, place: Place) -> RandomInput | None:
        path = f"vary.random.{key}"
        kind = self._find_kind(key, path, place, "random")
        if kind is None:
            return None
        word = next(iter(node.items), "")
        if len(node.items) != 1 or word not in DRAW_KINDS:
            self._refuse(place, path, f"needs one of {', '.join(DRAW_KINDS)}: [...]")
            return None
        elements = node.items[word].elements
        bound = kind if word == "choice" else _find_number_kind(kind, is_free=word == "normal")
        if bound is None:
            self._refuse(place, path, f"has no numbers; use choice: [...] instead of {word}")
            return None
        if not elements or (word != "choice" and len(elements) != PAIR):
            self._refuse(node.items[word].place, path, f"needs {PAIRS.get(word, 'a list')}")
            return None
        values = self._read_values(elements, bound, f"{path}.{word}")
        if None not in values and not _can_draw(word, values):
            self._refuse(node.items[word].place, path, f"needs two numbers, {PAIRS[word]}")
            values = [None]
        is_whole = word != "choice" and all(isinstance(one, int) for one in values)
        return None if None in values else RandomInput(key, word, tuple(values), is_whole)

    def _read_entries(self, node: ScenarioNode | None) -> Iterator[Values]:
        if node is None:
            return
        if not node.elements or not all(one.items for one in node.elements):
            self._refuse(node.place, "vary.list", "is not a list of maps of key paths and values")
            return
        for index, entry in enumerate(node.elements):
            found = {}
            for key, one in entry.items.items():
                path = f"vary.list[{index}].{key}"
                kind = self._find_kind(key, path, entry.key_places[key], "list")
                if kind is not None:
                    (found[key],) = self._read_values([one], kind, path, is_single=True)
            yield found

    def _read_values(
        self,
        nodes: Sequence[ScenarioNode],
        kind: inspect.Type,
        path: str,
        *,
        is_single: bool = False,
    ) -> list[PlainValue]:
        """Read values of a key, SI; None stands for what is wrong."""
        reader = TypedReader()
        values = [
            reader.read(node, kind, path if is_single else f"{path}[{index}]")
            for index, node in enumerate(nodes)
        ]
        self.issues += reader.issues
        return [_write_draws(one) for one in values]

    def _find_kind(
        self, key: str, path: str, place: Place, section: str = "grid"
    ) -> inspect.Type | None:
        """Find the type of a key that varies in one section only."""
        words = split_path(key)
        if self._seen.setdefault(".".join(words), section) != section:
            self._refuse(place, path, f"`{key}` varies in two ways; remove one")
            return None
        kind = find_type(ScenarioFormat, words, self._find_tag(words)) if words else None
        if kind is None or words[0] in FIXED or not self._has_entry(words):
            advice = "write it as in the file, such as robots.cart.count"
            self._refuse(place, path, f"there is no such key that can vary; {advice}")
            return None
        return kind

    def _list_entries(self, words: Sequence[str]) -> list[ScenarioNode]:
        """List the entries of the section that a key path begins with; empty if it is no list."""
        section = self._root.items.get(words[0])
        return section.elements if section is not None else []

    def _find_entry(self, words: Sequence[str]) -> ScenarioNode | None:
        listed = self._list_entries(words)
        word = words[1] if len(words) > 1 else ""
        if word.isdecimal() and int(word) < len(listed):
            return listed[int(word)]
        return next((one for one in listed if word and name_of(one) == word), None)

    def _find_tag(self, words: Sequence[str]) -> str:
        """Find the kind of the entry that a key path names."""
        entry = self._find_entry(words)
        tags = (entry.items.get(key) for key in ("do", "that")) if entry is not None else ()
        return next((str(one.value) for one in tags if one is not None), "")

    def _has_entry(self, words: Sequence[str]) -> bool:
        """Whether the entry of a list that a key path names exists."""
        is_listed = isinstance(self._plain.get(words[0]), list) and len(words) > 1
        return not is_listed or self._find_entry(words) is not None


def _find_count(node: ScenarioNode | None, default: int | None) -> int | None:
    """Find a whole number above 0."""
    value = node.value if node is not None else None
    is_count = isinstance(value, int) and not isinstance(value, bool) and value > 0
    return value if is_count else default  # type: ignore[return-value]  # it is an int


def _is_number(value: PlainValue) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _can_draw(kind: str, values: Sequence[PlainValue]) -> bool:
    """Whether a kind of draw can draw from its values."""
    return kind not in PAIRS or (all(map(_is_number, values)) and can_draw(kind, values))


def _write_draws(value: PlainValue) -> PlainValue:
    """Write draws as in a file."""
    if isinstance(value, Draw):
        return {value.kind: list(value.values)}
    if isinstance(value, dict):
        return {key: _write_draws(one) for key, one in value.items()}
    return [_write_draws(one) for one in value] if isinstance(value, list) else value


def _find_number_kind(kind: inspect.Type, unit: str = "", *, is_free: bool) -> inspect.Type | None:
    """Find the numbers of a type, with their unit; with `is_free` without their range."""
    if isinstance(kind, inspect.Metadata):
        inner = (kind.extra or {}).get("unit", unit)
        return _find_number_kind(kind.type, inner, is_free=is_free)
    if isinstance(kind, inspect.UnionType):
        found = (_find_number_kind(one, unit, is_free=is_free) for one in kind.types)
        return next((one for one in found if one is not None), None)
    if not isinstance(kind, inspect.FloatType | inspect.IntType | inspect.AnyType):
        return None
    if isinstance(kind, inspect.AnyType):
        kind = inspect.FloatType()
    return inspect.Metadata(type(kind)() if is_free else kind, extra={"unit": unit})
