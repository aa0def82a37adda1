"""Content, writing and comparison of the schemas."""

import json
from pathlib import Path

import pytest

from zensim.proto import schema
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.standard_messages import Twist, TwistStamped
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.service_catalog import SERVICES


def test_messages_are_listed_by_name() -> None:
    names = list(schema.list_messages())

    assert names == sorted(names)
    assert {"Twist", "Model", "SpawnEntityReport"} <= set(names)


def test_top_level_types_are_those_of_topics_and_services() -> None:
    spoken = schema.list_top_level_types()

    assert {Twist, TwistStamped, WorldClock, SpawnEntityReport} <= set(spoken)
    assert Model not in spoken


def test_message_schemas_keep_the_order_of_the_fields() -> None:
    described = schema.make_message_schemas()["$defs"]

    assert isinstance(described, dict)
    assert list(described["Quaternion"]["properties"]) == ["x", "y", "z", "w"]
    assert described["Quaternion"]["x-ros-type"] == "geometry_msgs/msg/Quaternion"
    assert "x-ros-type" not in described["Origin"]


def test_service_list_has_the_formats_of_request_and_response() -> None:
    listed = schema.list_services()

    assert list(listed) == sorted(SERVICES)
    assert listed["get_models"] == {
        "key": "sim/default/get_models",
        "request": "GetModelsRequest",
        "response": "GetModelsResponse",
        "codes": ["ResultCode"],
        "formats": ["MSGPACK", "JSON"],
    }


def test_key_list_holds_an_example_of_each_key() -> None:
    listed = schema.list_keys()

    assert isinstance(listed["keys"], dict)
    assert listed["keys"]["drive_state"] == "sim/default/drive/agent_1/state"
    assert {"agent_of", "last_chunk"}.isdisjoint(listed["keys"])
    assert isinstance(listed["topics"], dict)
    assert listed["topics"]["r1/cmd_vel"] == ["Twist", "TwistStamped"]


def test_codes_are_listed_by_enumeration() -> None:
    assert schema.list_codes()["SetEntityStateCode"] == {"INVALID_POSE": 101}


def test_golden_bytes_are_hex_and_json_is_text() -> None:
    sample = schema.make_golden()["DeleteEntityRequest"]

    assert sample == {
        "encoding": "application/cdr;simulation_interfaces/srv/DeleteEntity_Request",
        "CDR": "0001000007000000656e7469747900",
        "MSGPACK": "81a6656e74697479a6656e74697479",
        "JSON": '{"entity":"entity"}',
    }


def test_written_artefacts_have_not_drifted(tmp_path: Path) -> None:
    schema.write(tmp_path / "schemas")

    assert schema.find_stale(tmp_path / "schemas") == []
    assert json.loads((tmp_path / "schemas" / "keys.json").read_text()) == schema.list_keys()


def test_find_stale_lists_changed_missing_and_extra_files(tmp_path: Path) -> None:
    schema.write(tmp_path)
    (tmp_path / "keys.json").write_text("{}")
    (tmp_path / "codes.json").unlink()
    (tmp_path / "old.json").write_text("{}")

    assert schema.find_stale(tmp_path) == ["codes.json", "keys.json", "old.json"]


def test_main_writes_and_then_finds_nothing_stale(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert schema.main([], tmp_path) == 0
    assert schema.main(["--check"], tmp_path) == 0
    assert capsys.readouterr().out == ""


def test_main_names_stale_files_and_the_command_that_writes_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    schema.write(tmp_path)
    (tmp_path / "keys.json").write_text("{}")

    status = schema.main(["--check"], tmp_path)

    assert status == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert {"keys.json", "zensim.proto.schema"} <= set(line.replace("'", " ").split())


def test_main_refuses_other_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status = schema.main(["--chekc"], tmp_path)

    assert status == 2
    assert "--chekc" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
