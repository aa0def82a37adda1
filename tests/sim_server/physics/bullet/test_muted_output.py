"""Nothing that C code prints gets out, and nothing else is held back."""

import ctypes
import os
import sys

import pytest

from zensim.sim_server.physics.bullet.muted_output import suppress_output


def print_from_c(text: str) -> None:
    libc = ctypes.CDLL(None)
    libc.puts(text.encode())


def test_suppress_output_discards_both_streams_of_c_code(capfd: pytest.CaptureFixture[str]) -> None:
    with suppress_output():
        print_from_c("from puts")
        os.write(1, b"to stdout\n")
        os.write(2, b"to stderr\n")

    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_suppress_output_ends_with_its_block(capfd: pytest.CaptureFixture[str]) -> None:
    with suppress_output():
        pass
    os.write(1, b"to stdout\n")
    os.write(2, b"to stderr\n")

    said = capfd.readouterr()
    assert (said.out, said.err) == ("to stdout\n", "to stderr\n")


def test_suppress_output_keeps_earlier_output(capfd: pytest.CaptureFixture[str]) -> None:
    sys.stdout.write("before\n")
    print_from_c("before, from C")

    with suppress_output():
        print_from_c("inside")

    assert set(capfd.readouterr().out.splitlines()) == {"before", "before, from C"}


def test_suppress_output_ends_on_an_exception(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), suppress_output():
        raise KeyError

    os.write(1, b"heard\n")

    assert capfd.readouterr().out == "heard\n"


def test_suppress_output_leaves_no_file_open() -> None:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208  a list of numbers, not of paths

    for _ in range(5):
        with suppress_output():
            pass

    # The collector may close what other tests left.
    assert len(os.listdir("/proc/self/fd")) <= before  # noqa: PTH208
