"""Libraries that some sensors need: what a host lacks, as text of a key."""

import sys

import pytest

from zensim.proto import keys, sensor_libraries
from zensim.proto.sensor_libraries import (
    ADVICE,
    LIBRARIES,
    PACKAGES,
    Library,
    find_advice,
    find_library_fault,
    find_missing_libraries,
    format_missing,
    parse_missing,
)


@pytest.mark.parametrize("library", LIBRARIES)
def test_package_that_cannot_be_imported_is_missing(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, PACKAGES[library], None)

    assert PACKAGES[library] in find_missing_libraries()[library]


def test_opengl_is_missing_without_egl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor_libraries, "EGL", "libNoSuch.so.1")
    monkeypatch.setattr(sensor_libraries, "find_spec", lambda _: object())
    monkeypatch.setattr(sys, "platform", "linux")

    assert find_library_fault("opengl") == "libNoSuch.so.1 is not installed"
    assert find_library_fault("embree") == ""


@pytest.mark.parametrize(
    "missing", [frozenset[Library](), frozenset[Library]({"opengl"}), frozenset(LIBRARIES)]
)
def test_missing_libraries_are_read_from_their_key(missing: frozenset[Library]) -> None:
    key = keys.sensor_libraries("w", "s1", format_missing(missing))

    process, text = keys.parse_sensor_libraries(key)

    assert (process, parse_missing(text)) == ("s1", missing)


def test_other_keys_and_unknown_libraries_are_left_out() -> None:
    assert keys.parse_sensor_libraries("sim/w/sensors/s1/active") == ("", "")
    assert parse_missing("opengl+vulkan") == {"opengl"}


def test_each_library_has_advice() -> None:
    assert all(find_advice(library) == ADVICE[library] for library in LIBRARIES)
    assert find_advice("vulkan") == ""
