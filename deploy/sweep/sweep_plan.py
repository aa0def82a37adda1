"""The runs of a sweep, each known by its content, and validated before the first one starts."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from zensim.proto.bounded_files import hash_file
from zensim.scenario.scenario_nodes import Issue, ScenarioInvalid, ScenarioNode
from zensim.scenario.scenario_reader import (
    Scenario,
    digest_values,
    make_scenario,
    paused_collection,
)
from zensim.scenario.scenario_sources import apply_settings, read_merged_nodes, write_setting

NOT_CONTENT = ("vary", "record", "description", "include", "network", "ros", "viewer")
"""Sections that change no run in process."""
ID_LENGTH = 12
"""Hexadecimal digits."""
SEED_DIGITS = 8
NO_RECORD = "record=null"
"""Runs with equal seeds would write the same file."""
RECORDED_TOPICS = ("*/odom", "*/cmd_vel", "sim/**")
"""Topics recorded of runs that fail, where the file does not say which."""
MAX_MISTAKES = 20


class SweepRun(msgspec.Struct, frozen=True):
    """One run of a sweep."""

    id: str
    """Hash of its content and numbers; equal in every sweep."""
    seed: int
    number: int
    """Number of the seed of its combination."""
    repeat: int
    """Number among the runs that have to end in equal states."""
    inputs: Mapping[str, Any]
    """Values that vary by key path, SI."""
    settings: tuple[str, ...]
    """`KEY.PATH=VALUE`, that make the run of the file."""
    sha256: str
    """Hash of all values of its scenario."""
    timeout_s: float
    """Wall time."""


class SweepPlan(msgspec.Struct, frozen=True):
    """All runs of a sweep, in the order in which they start."""

    name: str
    file: str
    runs: tuple[SweepRun, ...]
    paths: tuple[str, ...]
    """Key paths that vary."""
    sha256: str
    """Hash of all values of the file."""
    recorded_topics: tuple[str, ...] = RECORDED_TOPICS


def make_plan(
    file: str, settings: Sequence[str] = (), on_run: Callable[[SweepRun], None] = lambda _: None
) -> SweepPlan:
    """Make all runs of a scenario file.

    Args:
        file: Its path.
        settings: `KEY.PATH=VALUE`, which win over the file.
        on_run: Called with each run that was validated; there may be 100,000.

    Raises:
        ScenarioInvalid: The file or a combination of its values has mistakes.
    """
    root = read_merged_nodes(file, settings)
    base = make_scenario(file, root)
    runs: dict[str, SweepRun] = {}
    with paused_collection():
        for run in _Planning(base, root, tuple(settings)).make_runs():
            runs[run.id] = run
            on_run(run)
    record = base.format.record
    return SweepPlan(
        base.name,
        file,
        tuple(runs.values()),
        tuple(base.variations.paths),
        base.sha256,
        (record and record.topics) or RECORDED_TOPICS,
    )


class _Planning:
    """The making of the runs of one file."""

    def __init__(self, base: Scenario, root: ScenarioNode, settings: tuple[str, ...]) -> None:
        self._base = base
        self._settings = settings
        # The section itself is validated once.
        varied = {key: node for key, node in root.items.items() if key != "vary"}
        self._root = ScenarioNode(root.place, varied, root.key_places)
        self._issues: list[Issue] = []

    def make_runs(self) -> Iterator[SweepRun]:
        """Make the runs; equal ones are not left out.

        Raises:
            ScenarioInvalid: A combination has mistakes.
        """
        for values in self._base.variations.combine(self._base.seed):
            varied = [NO_RECORD] if self._base.format.record is not None else []
            varied += [write_setting(path, value) for path, value in values.items()]
            scenario = self._make_scenario(varied)
            if scenario is not None:
                yield from self._make_runs_of(scenario, values, varied)
            if len(self._issues) >= MAX_MISTAKES:
                break
        if self._issues:
            raise ScenarioInvalid(tuple(self._issues[:MAX_MISTAKES]))

    def _make_runs_of(
        self, scenario: Scenario, values: Mapping[str, Any], varied: Sequence[str]
    ) -> Iterator[SweepRun]:
        variations = self._base.variations
        content = digest_content(scenario)
        for number in range(variations.seeds or 1):
            settings, seeded = list(varied), scenario
            # Without `seeds`, the run is that of the file, with the seed of the file.
            key = f"{content} {number if variations.seeds else '-'}"
            if variations.seeds:
                seed = int(_digest(key)[:SEED_DIGITS], 16)
                settings.append(write_setting("time.seed", seed))
                found = self._make_scenario(settings)
                if found is None:
                    continue
                seeded = found
            for repeat in range(variations.repeats):
                yield SweepRun(
                    _digest(f"{key} {repeat}")[:ID_LENGTH],
                    seeded.seed,
                    number,
                    repeat,
                    values,
                    (*self._settings, *settings),
                    self._digest_whole(seeded),
                    scenario.format.end.timeout,
                )

    def _make_scenario(self, settings: Sequence[str]) -> Scenario | None:
        try:
            return make_scenario(self._base.file, apply_settings(self._root, settings))
        except ScenarioInvalid as error:
            self._issues += [_add_settings(issue, settings) for issue in error.issues]
            return None

    def _digest_whole(self, scenario: Scenario) -> str:
        """Digest what a reader of the file with the settings of the run reads."""
        section = {key: value for key, value in self._base.plain.items() if key == "vary"}
        return digest_values({**scenario.plain, **section})


def digest_content(scenario: Scenario) -> str:
    """Digest what the states of a run depend on, without its seed of the sweep.

    The files that the scenario names count with their bytes; those that these name do not.
    """
    kept = {key: value for key, value in scenario.plain.items() if key not in NOT_CONTENT}
    named = sorted({str(path): _digest_file(path) for path in _list_files(scenario)}.items())
    return _digest(" ".join([digest_values(kept), *(digest for _, digest in named)]))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _digest_file(path: Path) -> str:
    return hash_file(path)[0]


def _list_files(scenario: Scenario) -> Iterator[Path]:
    """List the files that a scenario names: world, models, poses, commands, own code."""
    found = (scenario.find_file(path, word) for path, word in _list_words(scenario))
    yield from (path for path in found if path.is_file())


def _list_words(scenario: Scenario) -> Iterator[tuple[str, str]]:
    yield "world.load", scenario.format.world.load
    for index, group in enumerate(scenario.format.robots):
        yield f"robots[{index}].model", group.model
        for word in group.controllers:
            yield f"robots[{index}].controllers", word
        if isinstance(group.poses, str):
            yield f"robots[{index}].poses", group.poses
    for section in ("behaviours", "checks"):
        for index, entry in enumerate(getattr(scenario.format, section)):
            yield f"{section}[{index}].file", getattr(entry, "file", "")
            module, _, _ = getattr(entry, "call", "").partition(":")
            yield "", f"{module.replace('.', '/')}.py"


def _add_settings(issue: Issue, settings: Sequence[str]) -> Issue:
    combination = " ".join(settings)
    message = f"{issue.message} (with {combination})" if combination else issue.message
    return msgspec.structs.replace(issue, message=message)
