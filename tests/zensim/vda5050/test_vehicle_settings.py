"""Files and addresses that a user gives."""

from pathlib import Path

import pytest

from zensim.vda5050.broker_links import parse_broker
from zensim.vda5050.fleet_program import make_serial
from zensim.vda5050.record_store import RecordStore
from zensim.vda5050.vehicle import VehicleRecord
from zensim.vda5050.vehicle_settings import BadSettings, read_settings


def test_settings_add_actions_to_the_default_ones(tmp_path: Path) -> None:
    (file := tmp_path / "vehicles.json").write_text('{"actions": {"scan": {"duration_s": 2}}}')

    found = read_settings(file)

    assert found.all_actions["scan"].duration_s == 2.0
    assert found.all_actions["pick"].kind == "attach"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"max_sped": 1}',
        '{"max_speed": -1}',
        '{"manufacturer": "a/b"}',
        '{"actions": {"a": {"kind": "fly"}}}',
        "[" * 100_000,
    ],
)
def test_other_settings_are_refused(tmp_path: Path, text: str) -> None:
    (file := tmp_path / "vehicles.json").write_text(text)

    with pytest.raises(BadSettings):
        read_settings(file)


def test_address_of_a_broker_has_its_port_or_the_usual_one() -> None:
    assert parse_broker("mqtt://h")[:2] == ("h", 1883)
    assert parse_broker("mqtt://[::1]:9")[:2] == ("::1", 9)
    assert parse_broker("mqtts://h").tls is not None
    assert parse_broker("mqtts://h")[:2] == ("h", 8883)


@pytest.mark.parametrize("url", ["", "h:1883", "http://h", "mqtt://", "mqtt://h:x", "mqtt://a:b@h"])
def test_other_addresses_are_refused(url: str) -> None:
    with pytest.raises(ValueError, match="`broker`"):
        parse_broker(url)


def test_serial_number_has_only_characters_of_topics() -> None:
    assert make_serial("fleet/r1+ü") == "fleet_r1__"


def test_records_outlive_the_store(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "vehicles.db")
    store.save({"r1": VehicleRecord(charge=5.0)})
    with pytest.raises(OSError, match="`state`"):
        RecordStore(tmp_path / "vehicles.db")
    store.close()

    again = RecordStore(tmp_path / "vehicles.db")
    found, missing = again.load("r1"), again.load("r2")
    again.close()

    assert (found, missing) == (VehicleRecord(charge=5.0), None)


def test_other_file_is_no_store(tmp_path: Path) -> None:
    (file := tmp_path / "other").write_text("no database" * 100)

    with pytest.raises(OSError, match="`state`"):
        RecordStore(file)
