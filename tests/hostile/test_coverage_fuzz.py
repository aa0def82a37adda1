"""Inputs that fuzzers kept are read or refused, and a short run finds more."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.machine import ROOT
from tests.hostile.coverage_fuzz import READERS, list_kept, list_seeds


@pytest.mark.parametrize("reader", READERS)
def test_kept_inputs_are_read_or_refused(reader: str) -> None:
    inputs = [*list_seeds(reader), *list_kept(reader)]
    assert len(list_kept(reader)) > 50

    for data in inputs:
        READERS[reader](data)


@pytest.mark.short_form
def test_short_run_keeps_inputs(tmp_path: Path) -> None:
    words = ("tests.hostile.coverage_fuzz", "meshes", "--seconds", "1", "--kept", str(tmp_path))

    subprocess.run([sys.executable, "-m", *words], cwd=ROOT, check=True, capture_output=True)

    assert list_kept("meshes", tmp_path)
