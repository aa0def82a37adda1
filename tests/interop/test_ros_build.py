"""Builds of rclpy and the bridge: pinned, kept, and left out where they are missing."""

import re
from pathlib import Path

import pytest

from benchmarks.benchmark_report import Section
from tests.interop import __main__ as interop
from tests.interop import interop_rclpy
from tests.interop.peer_build import PeersMissing
from tests.interop.ros_build import (
    PLUGIN_VERSION,
    REQUIREMENTS,
    SOURCES,
    check_ros_cache,
    find_bridge,
    find_ros_python,
    prepare_ros,
)

LINE = re.compile(r"[a-z0-9_.-]+==[0-9a-z.]+ --hash=sha256:[0-9a-f]{64}")


@pytest.fixture
def _empty_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("INTEROP_CACHE", str(tmp_path))
    monkeypatch.setenv("INTEROP", "cached")


def test_every_wheel_has_a_version_and_a_hash() -> None:
    lines = [one for one in REQUIREMENTS.read_text().splitlines() if not one.startswith("#")]

    assert len(lines) > 50
    assert [one for one in lines if not LINE.fullmatch(one)] == []


def test_bridge_is_of_the_version_that_the_page_names() -> None:
    manifest = (SOURCES / "Cargo.toml").read_text()

    assert f'zenoh-plugin-ros2dds = {{ version = "={PLUGIN_VERSION}"' in manifest
    assert PLUGIN_VERSION in str(interop_rclpy.__doc__)


@pytest.mark.parametrize(
    ("said", "missed"),
    [
        ("100 frames of 10 robots under world after 0.24 s", []),
        (
            "90 frames of 9 robots under world after 0.24 s",
            ["90 frames of 9 robots under world after 0.24 s"],
        ),
        ("", ["no line of all frames under world"]),
    ],
)
def test_check_that_prints_no_figure_is_missed(said: str, missed: list[str]) -> None:
    others = ["square of 1.6 m closed to 0.019 m", "heard again 7.2 s after the simulator ended"]

    rows = list(interop_rclpy.judge_checks([said, *others]))

    wrong = [row.what.partition("fail: ")[2] for row in rows if row.is_missed]
    assert wrong == missed


@pytest.mark.usefixtures("_empty_cache")
def test_cached_run_builds_nothing_and_leaves_rclpy_out() -> None:
    with pytest.raises(PeersMissing):
        prepare_ros(is_short=True)

    section = interop.measure("rclpy", is_short=True)

    assert isinstance(section, Section)
    assert "Left out" in section.text
    assert section.missed == ()


@pytest.mark.usefixtures("_empty_cache")
def test_cache_is_complete_with_both_builds() -> None:
    for path in (find_ros_python(), find_bridge()):
        with pytest.raises(PeersMissing, match=re.escape(str(path))):
            check_ros_cache()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    check_ros_cache()
