"""The report of a description and its limits."""

from tests.sim_server.description.robots import mentions, subjects
from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.report import MAX_ENTRIES, MAX_SUSPICIOUS_ENTRIES, ParseReport


def test_report_lists_entries_in_order() -> None:
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


def test_unread_tag_is_suspicious_when_a_tag_is_similar() -> None:
    report = ParseReport()

    report.unread_tag("plugin", "wheel_seperation", ["wheel_separation", "wheel_diameter"])

    assert subjects(report.entries(), "suspicious") == ["plugin: <wheel_seperation>"]
    assert mentions(report.entries(), "suspicious", "<wheel_separation>")


def test_unread_tag_is_unknown_when_no_tag_is_similar() -> None:
    report = ParseReport()

    report.unread_tag("plugin", "banana", ["wheel_separation"])

    assert subjects(report.entries(), "unknown") == ["plugin: <banana>"]


def test_report_has_equal_entries_once() -> None:
    report = ParseReport()

    report.ignored("a", "no")
    report.ignored("a", "no")

    assert len(report.entries()) == 1


def test_full_report_counts_further_entries() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES):
        report.unknown(f"tag {index}", "")
    report.ignored("one more", "")
    report.unread_tag("plugin", "banana", ["bananas"])

    assert len(report.entries()) == MAX_ENTRIES + 1
    assert mentions(report.entries(), "ignored", "report: 2 ")


def test_full_report_accepts_suspicious_entries() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES + 1):
        report.unknown(f"tag {index}", "")
    for index in range(MAX_SUSPICIOUS_ENTRIES + 1):
        report.suspicious(f"mesh {index}", "")

    assert len(subjects(report.entries(), "suspicious")) == MAX_SUSPICIOUS_ENTRIES
    assert mentions(report.entries(), "ignored", "report: 2 ")


def test_entries_of_several_links_are_one_entry_with_a_count() -> None:
    report = ParseReport()

    for name in "abcde":
        report.ignored(f"gazebo '{name}': <erp>", "no")
        report.unknown(f"link '{name}', visual 2: <zebra>", "not read")

    assert [(e.status, e.subject, e.reason) for e in report.entries()] == [
        ("ignored", "gazebo 'a', 'b', 'c' and 2 more: <erp>", "no (5 times)"),
        ("unknown", "link 'a', 'b', 'c' and 2 more, visual: <zebra>", "not read (5 times)"),
    ]


def test_entries_with_other_reasons_and_suspicious_ones_stay_apart() -> None:
    report = ParseReport()

    report.ignored("gazebo 'a': <erp>", "no")
    report.ignored("gazebo 'b': <erp>", "never")
    report.suspicious("link 'a'", "odd")
    report.suspicious("link 'b'", "odd")

    assert [e.subject for e in report.entries()] == [
        *("gazebo 'a': <erp>", "gazebo 'b': <erp>"),
        *("link 'a'", "link 'b'"),
    ]


def test_grouped_entries_leave_room_for_others() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES + 1):
        report.unread_tag(f"link 'l{index}'", "zebra", ["pose"])
    report.ignored("last", "no")

    assert subjects(report.entries(), "ignored") == ["last"]


def test_full_report_has_plugins_drives_and_controllers() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES + 1):
        report.applied(f"tag {index}", "")
    for index in range(MAX_SUSPICIOUS_ENTRIES + 1):
        report.suspicious(f"mesh {index}", "")
    report.unknown("plugin 'mecanum'", "no plug-in has this file name")
    report.applied("plugin 'wheels'", "drive")
    report.suspicious("drive", "no drive")
    report.ignored("controller 'arm'", "does not drive the robot")

    last = [entry.subject for entry in report.entries()][-5:-1]
    assert last == ["plugin 'mecanum'", "plugin 'wheels'", "drive", "controller 'arm'"]


def test_applied_tags_of_many_links_are_one_entry() -> None:
    report = ParseReport()

    for index in range(MAX_ENTRIES + 1):
        report.applied(f"gazebo 'roller_{index}': <mu1>", "0.8")
    report.applied("gazebo 'wheel': <mu1>", "1")

    assert [(one.subject, one.reason) for one in report.entries()] == [
        ("gazebo 'roller_0', 'roller_1', 'roller_2' and 198 more: <mu1>", "0.8 (201 times)"),
        ("gazebo 'wheel': <mu1>", "1"),
    ]


def test_entries_of_like_models_of_a_world_are_one_entry() -> None:
    report = ParseReport()

    for name in ("chair_1", "chair_2"):
        report.repeat(ReportEntry("ignored", "link 'leg': <erp>", "no"), of=name)
        report.repeat(ReportEntry("suspicious", "link 'seat'", "odd"), of=name)

    assert [one.subject for one in report.entries()] == [
        *("chair_1, chair_2: link 'leg': <erp>", "chair_1: link 'seat'", "chair_2: link 'seat'")
    ]


def test_applied_tags_leave_room_for_those_that_are_not_read() -> None:
    report = ParseReport()
    for number in range(MAX_ENTRIES + 1):
        report.applied(f"tag {number}")
    report.unread_tag("link", "zebra", ["pose"])
    report.unread_attribute("link", "zebra", ["name"])

    assert subjects(report.entries(), "unknown") == ["link: <zebra>", "link: attribute zebra"]


def test_parts_of_a_link_are_one_entry() -> None:
    report = ParseReport()
    for name in ("c0", "c1"):
        report.applied(f"link 'a', collision '{name}': <mu1>")

    assert [(one.subject, one.reason) for one in report.entries()] == [
        ("link 'a', collision: <mu1>", "(2 times)")
    ]


def test_unread_attribute_is_suspicious_when_one_is_similar() -> None:
    report = ParseReport()
    report.unread_attribute("joint 'j', limit", "velocty", ["velocity"])

    assert subjects(report.entries(), "suspicious") == ["joint 'j', limit: attribute velocty"]
