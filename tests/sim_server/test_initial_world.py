"""The initial world: that of the journal before the requested one."""

from pathlib import Path

import pytest

from tests.engines import STEP_NS
from tests.sim_server.changed_configs import with_settings
from tests.sim_server.journal.journaled_server import JournaledServer
from zensim.proto.bus.bus_config import BusConfig
from zensim.sim_server.initial_world import load_initial_world
from zensim.sim_server.journal.server_journal import Journal, open_journal
from zensim.sim_server.journal.sqlite_store import JournalError
from zensim.sim_server.server_config import ServerConfig

CONFIG = with_settings(ServerConfig(bus=BusConfig(), journal="lab"), world="walls")


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    kept = JournaledServer(tmp_path, "r0")
    kept.parts.pacing.target_real_time_factor = 2.0
    kept.tracker.record()
    kept.crash()
    return open_journal(str(tmp_path))


def test_server_restores_the_world_of_its_journal(journal: Journal) -> None:
    loaded, config = load_initial_world(CONFIG, journal)

    assert loaded.model.name == "empty"
    assert (config.step_ns, config.settings.pace.rtf, config.settings.start.seed) == (
        STEP_NS,
        2.0,
        7,
    )


def test_server_keeps_the_requested_factor(journal: Journal) -> None:
    _, config = load_initial_world(with_settings(CONFIG, rtf=0.5), journal)

    assert config.settings.pace.rtf == 0.5


def test_server_loads_its_world_when_the_journal_is_new(tmp_path: Path) -> None:
    loaded, _ = load_initial_world(CONFIG, open_journal(str(tmp_path)))

    assert loaded.model.models


@pytest.mark.parametrize(
    ("change", "response_"),
    [
        (
            {"world_name": "other"},
            "lab is the journal of world 'default'; use `world_name` default",
        ),
        ({"step_hz": 100.0}, "lab counts steps of 240 Hz, not 100; leave `step_hz` out"),
    ],
)
def test_server_refuses_the_journal_of_another_world(
    journal: Journal, change: dict[str, object], response_: str
) -> None:
    with pytest.raises(JournalError) as caught:
        load_initial_world(with_settings(CONFIG, **change), journal)

    assert str(caught.value).startswith(response_)
