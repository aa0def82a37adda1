"""Plug-in of pytest: fixtures with a simulation, `expect`, and files about failed tests.

It is loaded by its entry point. Only a test that uses a fixture loads the simulation.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator

    from zensim.api.expectations import RobotExpectation, TopicExpectation
    from zensim.api.robot import EntityHandle
    from zensim.api.sim import Sim
    from zensim.api.simulation import Simulation
    from zensim.api.topic import Topic

SCENARIO_SUFFIX = ".scenario.yaml"
RESULTS_FOLDER = "test-results"
MAX_FOLDER_NAME = 120
PHASE_KEY = pytest.StashKey[dict[str, pytest.TestReport]]()
_current: list[Simulation] = []
"""The simulations of the running test, the newest last."""
_servers: list[Sim] = []
"""The servers of this session; only the last one may be in use."""


@overload
def expect(subject: EntityHandle, sim: Simulation | None = None) -> RobotExpectation: ...
@overload
def expect(subject: Topic[Any], sim: Simulation | None = None) -> TopicExpectation: ...
def expect(
    subject: EntityHandle | Topic[Any], sim: Simulation | None = None
) -> RobotExpectation | TopicExpectation:
    """Expect something of a robot or a topic; the methods step the simulation until it holds.

    Args:
        subject: A robot, or a topic.
        sim: Its simulation; that of the test's fixture if it is not given.

    Returns:
        `RobotExpectation` or `TopicExpectation`.

    Raises:
        RuntimeError: There is no simulation to step.
        TypeError: The subject is neither robot nor topic.
    """
    from zensim.api.expectations import RobotExpectation, TopicExpectation
    from zensim.api.robot import EntityHandle
    from zensim.api.topic import Topic

    if sim is None and not _current:
        raise RuntimeError("no simulation to step; use a fixture of zensim, or give sim=")
    simulation = sim or _current[-1]
    if isinstance(subject, EntityHandle):
        return RobotExpectation(simulation, subject)
    if isinstance(subject, Topic):
        return TopicExpectation(simulation, subject)
    raise TypeError(f"expect takes a robot or a topic, not {type(subject).__name__}")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line(
        "markers", "zensim(world, record, **keywords of World): the simulation of a test"
    )


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """Collect scenario files."""
    if file_path.name.endswith(SCENARIO_SUFFIX):
        return ScenarioFile.from_parent(parent, path=file_path)
    return None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Keep the report of each phase for the fixtures."""
    del call
    report = yield
    item.stash.setdefault(PHASE_KEY, {})[str(report.when)] = report
    return report


@pytest.fixture
def zensim_world(request: pytest.FixtureRequest) -> Iterator[Simulation]:
    """A paused world in this process, of this test only."""
    from zensim.api.in_process_world import World

    options = read_marker(request)
    with World(**{key: value for key, value in options.items() if key != "record"}) as world:
        world.watch_collisions()
        yield from _watch(request.node, world)


@pytest.fixture(scope="session")
def zensim_server() -> Iterator[Sim]:
    """A paused server of this session with a pool, on a free port, without ROS 2."""
    from zensim.api.connections import launch

    with launch() as sim:
        _servers.append(sim)
        yield sim
    while _servers:
        _servers.pop().close()


@pytest.fixture
def zensim_sim(request: pytest.FixtureRequest, zensim_server: Sim) -> Iterator[Simulation]:  # noqa: ARG001  it starts the first
    """A paused and reset server in the world of this test; another one if it ended in a test."""
    from zensim.api.api_errors import ConnectionLost
    from zensim.api.connections import launch

    options = read_marker(request)
    try:
        _servers[-1].pause()
    except ConnectionLost:
        _servers.append(launch())
    server = _servers[-1]
    server.load(options.get("world", "empty"))
    yield from _watch(request.node, server)
    with suppress(ConnectionLost):
        server.pause()
        server.reset()


def read_marker(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Return the options of all marks `zensim` of a test; those of inner ones count.

    Raises:
        ValueError: An option has no keyword, or the fixture of the request does not know it.
    """
    from zensim.proto.settings.server_settings import WorldKeywords

    chain = request.node.listchain()
    marks = [mark for one in chain for mark in one.own_markers if mark.name == "zensim"]
    if values := [value for mark in marks for value in mark.args]:
        raise ValueError(f"mark zensim: {values[0]!r} has no keyword; use world={values[0]!r}")
    options = {key: value for mark in marks for key, value in mark.kwargs.items()}
    known = {"world", "record"}
    if request.fixturename == "zensim_world":
        known |= WorldKeywords.__annotations__.keys()
    if unknown := options.keys() - known:
        raise ValueError(
            f"mark zensim: {request.fixturename} has no option {sorted(unknown)}; "
            f"it has {sorted(known)}; zensim_world has all keywords of World"
        )
    return options


class ScenarioFile(pytest.File):
    """A scenario file, which is a test."""

    def collect(self) -> Iterator[ScenarioItem]:
        """List its only test."""
        yield ScenarioItem.from_parent(self, name=self.path.name.removesuffix(SCENARIO_SUFFIX))


class ScenarioItem(pytest.Item):
    """Runs a scenario in this process; fails if one of its checks does."""

    def runtest(self) -> None:
        """Run it, without a traceback where it fails."""
        from zensim.scenario.scenario_loading import load
        from zensim.scenario.scenario_nodes import ScenarioInvalid

        try:
            with load(self.path) as run:
                report = run.run()
        except ScenarioInvalid as error:
            pytest.fail(str(error), pytrace=False)
        failed = [one.message or one.name for one in report.checks if one.is_failure]
        if not report.is_passed:
            pytest.fail("\n".join([report.error, *failed]).strip(), pytrace=False)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Name it."""
        return self.path, None, f"scenario {self.name}"


def _watch(node: pytest.Item, sim: Simulation) -> Iterator[Simulation]:
    """Lend a simulation to a test; write files if it fails."""
    from zensim.api.run_artefacts import RunArtefacts

    artefacts = RunArtefacts(sim)
    _current.append(sim)
    yield sim
    _current.remove(sim)
    report = node.stash.get(PHASE_KEY, {}).get("call")
    if report is not None and report.failed:
        folder = Path(node.config.rootpath) / RESULTS_FOLDER / _name_folder(node.nodeid)
        paths = artefacts.write(folder, test=node.nodeid, message=report.longreprtext[-4000:])
        for path in paths:
            node.user_properties.append((path.stem, str(path)))
    artefacts.close()


def _name_folder(test: str) -> str:
    return re.sub(r"[^\w.=-]+", "-", test).strip("-")[-MAX_FOLDER_NAME:]
