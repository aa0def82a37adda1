"""Silence: what C code prints goes nowhere while it lasts, and only then."""

import ctypes
import os
import sys

import pytest

from zensim.sim_server.physics.silence import silenced


def print_from_c(text: str) -> None:
    libc = ctypes.CDLL(None)
    libc.puts(text.encode())


def test_silence_swallows_both_streams_of_c_code(capfd: pytest.CaptureFixture[str]) -> None:
    with silenced():
        print_from_c("from puts")
        os.write(1, b"to stdout\n")
        os.write(2, b"to stderr\n")

    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_silence_ends_with_its_block(capfd: pytest.CaptureFixture[str]) -> None:
    with silenced():
        pass
    os.write(1, b"to stdout\n")
    os.write(2, b"to stderr\n")

    said = capfd.readouterr()
    assert (said.out, said.err) == ("to stdout\n", "to stderr\n")


def test_silence_keeps_what_was_said_before(capfd: pytest.CaptureFixture[str]) -> None:
    sys.stdout.write("before\n")
    print_from_c("before, from C")

    with silenced():
        print_from_c("inside")

    assert set(capfd.readouterr().out.splitlines()) == {"before", "before, from C"}


def test_silence_ends_when_something_fails_inside(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), silenced():
        raise KeyError

    os.write(1, b"heard\n")

    assert capfd.readouterr().out == "heard\n"


def test_silence_leaves_no_file_open() -> None:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208  a list of numbers, not of paths

    for _ in range(5):
        with silenced():
            pass

    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208
