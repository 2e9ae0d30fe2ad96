"""What goes wrong, in a line; findings as data."""

from __future__ import annotations

import math

from sysid.errors import (
    MAX_LINE_CHARACTERS,
    MAX_LINES,
    Finding,
    LogError,
    finding_from_dict,
    one_line,
    shortened,
)


def test_an_error_is_one_line_of_a_length_to_be_read() -> None:
    assert shortened("short\n" + "x" * MAX_LINE_CHARACTERS) == "short\n" + "x" * MAX_LINE_CHARACTERS
    long = shortened("begin" + "x" * 10**6 + "end")
    assert len(long) <= MAX_LINE_CHARACTERS
    assert long.startswith("beginx")
    assert long.endswith("xend")
    assert shortened(long) == long
    many = shortened("\n".join(f"a.toml:{k}: wrong and not what it should be" for k in range(500)))
    assert many.splitlines()[-1] == f"and {500 - MAX_LINES + 1} more"
    assert len(many.splitlines()) == MAX_LINES
    assert shortened(many) == many
    assert (
        str(LogError("unknown signal 'a\nb'", "m.toml", "line 3"))
        == "m.toml: line 3: unknown signal 'a b'"
    )


def test_a_librarys_words_are_one_short_line() -> None:
    assert one_line(ValueError("two\n  lines")) == "two lines"
    assert one_line(ValueError()) == "ValueError"
    assert len(one_line(ValueError("x" * 10**6))) == 200


def test_a_finding_comes_back_from_its_dictionary() -> None:
    finding = Finding("gap", "q_radps", "warning", "a gap", {"total_s": 1.5, "longest_s": math.inf})
    assert finding.as_dict()["numbers"] == {"total_s": 1.5, "longest_s": None}
    back = finding_from_dict(finding.as_dict())
    assert (back.code, back.channel, back.severity, back.message) == (
        "gap",
        "q_radps",
        "warning",
        "a gap",
    )
    assert back.numbers["total_s"] == 1.5
    assert math.isnan(back.numbers["longest_s"])
