"""`python -m benchmarks [NAME ...] [--short | --write]`: measure, and print.

Sections go to docs/benchmark_results.md with `--write`, and if none is named.
"""

from benchmarks.benchmark_report import HEAD, NAMES, measure
from benchmarks.document_command import Document
from benchmarks.machine import ROOT

PAGE = ROOT / "docs" / "benchmark_results.md"
DOCUMENT = Document(
    program="benchmarks",
    names=NAMES,
    make=measure,
    short="a few seconds each; says little",
    path=PAGE,
    head=HEAD,
)

if __name__ == "__main__":
    DOCUMENT.write()
