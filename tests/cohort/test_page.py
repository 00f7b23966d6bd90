"""The page of a cohort: order, escaping, and sorting and filtering in a browser."""

from __future__ import annotations

import re

import pytest

from chromium import Tab, browser
from cohort_runners import row
from spinestiff.cohort.group import Member
from spinestiff.cohort.page import Section, cohort_page


def members():
    found = [Member(f"sub-{number:02d}", "done", "", row(f"sub-{number:02d}", number)) for number in range(1, 9)]
    found[2] = Member("sub-03", "failed", "<script>alert(1)</script> & more")
    found[4] = Member("sub-05", "out of date", "was made before its inputs changed", found[4].row)
    doubtful = found[5].row.model_copy(update={"status": "DOUBTFUL", "failed_checks": ("rest and push",)})
    found[5] = Member("sub-06", "done", "", doubtful)
    return found


def order(page):
    return re.findall(r'<th scope="row">(?:<a href="[^"]*">)?(sub-\d+)', page)


def test_what_needs_a_look_comes_first_and_links_to_its_report():
    page = cohort_page(members())
    assert order(page) == ["sub-03", "sub-05", "sub-06", "sub-01", "sub-02", "sub-04", "sub-07", "sub-08"]
    assert '<a href="sub-01/results/report.html">sub-01</a>' in page
    assert len(re.findall(r"<tr [^>]* data-look>", page)) == 3
    assert cohort_page(members()) == page


def test_texts_are_escaped_and_sections_are_shown():
    table = ("A table", ("x", "y"), (("1", "<2"),))
    section = Section("People & more", ("One <b>sentence</b>.",), (table,), b"png", "A")
    page = cohort_page(members(), [section])
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; more" in page
    assert "One &lt;b&gt;sentence&lt;/b&gt;." in page
    assert "<td>&lt;2</td>" in page
    assert "data:image/png;base64,cG5n" in page
    assert "default-src 'none'" in page


SHOWN = """[...document.querySelectorAll('#table tbody tr')].filter(row => !row.hidden)
    .map(row => row.cells[0].textContent).join()"""
SET = """(() => {{ const field = document.getElementById('{0}'); field.value = '{1}';
    field.dispatchEvent(new Event('input', {{bubbles: true}})); }})()"""


@pytest.mark.skipif(browser() is None, reason="no Chromium")
def test_the_table_sorts_and_filters_in_a_browser(tmp_path):
    path = tmp_path / "cohort.html"
    path.write_text(cohort_page(members()), encoding="utf-8")
    with Tab(tmp_path / "profile") as tab:
        tab.open(path)
        assert tab.run(SHOWN) == "sub-03,sub-05,sub-06,sub-01,sub-02,sub-04,sub-07,sub-08"
        click = "document.querySelectorAll('#table thead button')[{}].click()"
        tab.run(click.format(0))
        assert tab.run(SHOWN) == "sub-01,sub-02,sub-03,sub-04,sub-05,sub-06,sub-07,sub-08"
        # Ages are 10 + number % 8; who has no row stays at the end, either way.
        tab.run(click.format(3))
        assert tab.run(SHOWN) == "sub-08,sub-01,sub-02,sub-04,sub-05,sub-06,sub-07,sub-03"
        tab.run(click.format(3))
        assert tab.run(SHOWN) == "sub-07,sub-06,sub-05,sub-04,sub-02,sub-01,sub-08,sub-03"
        tab.run(click.format(3))
        assert tab.run(SHOWN) == "sub-03,sub-05,sub-06,sub-01,sub-02,sub-04,sub-07,sub-08"
        tab.run(SET.format("state", "look"))
        assert tab.run(SHOWN) == "sub-03,sub-05,sub-06"
        tab.run(SET.format("state", ""))
        tab.run(SET.format("known", "doubtful"))
        assert tab.run(SHOWN) == "sub-06"
        tab.run(SET.format("known", ""))
        tab.run(SET.format("search", "ALERT sub"))
        assert tab.run(SHOWN) == "sub-03"
        assert tab.run("document.getElementById('shown').textContent") == "1 of 8"
        assert tab.requests == [path.as_uri()]
        assert tab.complaints == []
