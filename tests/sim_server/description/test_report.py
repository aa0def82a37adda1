"""The report tells what became of each tag, and stays small."""

from tests.sim_server.description.robots import mentions, subjects
from zensim.sim_server.description.report import MAX_ENTRIES, MAX_SUSPICIOUS_ENTRIES, ParseReport


def test_report_lists_entries_in_order_when_noted() -> None:
    report = ParseReport()

    report.applied("a")
    report.ignored("b", "no")
    report.unknown("c", "what")
    report.suspicious("d", "odd")

    assert [(e.status, e.subject, e.reason) for e in report.entries()] == [
        ("applied", "a", ""),
        ("ignored", "b", "no"),
        ("unknown", "c", "what"),
        ("suspicious", "d", "odd"),
    ]


def test_report_suggests_a_tag_when_one_looks_misspelt() -> None:
    report = ParseReport()

    report.unread_tag("plugin", "wheel_seperation", ["wheel_separation", "wheel_diameter"])

    assert subjects(report.entries(), "suspicious") == ["plugin: <wheel_seperation>"]
    assert mentions(report.entries(), "suspicious", "<wheel_separation>")


def test_report_calls_a_tag_unknown_when_nothing_is_like_it() -> None:
    report = ParseReport()

    report.unread_tag("plugin", "banana", ["wheel_separation"])

    assert subjects(report.entries(), "unknown") == ["plugin: <banana>"]


def test_report_says_a_thing_once_when_it_is_noted_twice() -> None:
    report = ParseReport()

    report.ignored("a", "no")
    report.ignored("a", "no")

    assert len(report.entries()) == 1


def test_report_counts_the_rest_when_it_is_full() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES):
        report.unknown(f"tag {index}", "")
    report.ignored("one more", "")
    report.unread_tag("plugin", "banana", ["bananas"])

    assert len(report.entries()) == MAX_ENTRIES + 1
    assert mentions(report.entries(), "ignored", "report: 2 ")


def test_report_keeps_what_is_suspicious_when_it_is_full_of_the_rest() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES + 1):
        report.unknown(f"tag {index}", "")
    for index in range(MAX_SUSPICIOUS_ENTRIES + 1):
        report.suspicious(f"mesh {index}", "")

    assert len(subjects(report.entries(), "suspicious")) == MAX_SUSPICIOUS_ENTRIES
    assert mentions(report.entries(), "ignored", "report: 2 ")
