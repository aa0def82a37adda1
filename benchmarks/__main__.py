"""`python -m benchmarks [NAME ...] [--short]`: measure, print, and rewrite docs/benchmarks.md.

The page is written only if every section was measured at full length.
"""

from benchmarks.benchmark_report import HEAD, NAMES, measure
from benchmarks.document_command import Document
from benchmarks.machine import ROOT

PAGE = ROOT / "docs" / "benchmarks.md"
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
