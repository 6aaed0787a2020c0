from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hierax.runtime.deployment.deployment import DeploymentError
from hierax.runtime.deployment.tree import MAX_PARTS, MAX_TEXT_CHARS, read_tree
from hierax.schemas.limits import MAX_DEPTH


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("~", None),
        ("", None),
        ("true", True),
        ("FALSE", False),
        ("on", "on"),
        ("no", "no"),
        ("12", 12),
        ("-3", -3),
        ("0x1f", 31),
        ("0o17", 15),
        ("000001", "000001"),
        ("1_000", "1_000"),
        ("12:30:45", "12:30:45"),
        ("2026-01-02", "2026-01-02"),
        ("1e-3", 0.001),
        ("1.", 1.0),
        (".5", 0.5),
        ("-2.5e+3", -2500.0),
        ("-.inf", -math.inf),
        ("'12'", "12"),
        ("!!str 12", "12"),
        ("!!float 1", 1.0),
        ("!!binary AQI=", b"\x01\x02"),
        ("[1, [a]]", [1, ["a"]]),
        ("{a: {b: 1}}", {"a": {"b": 1}}),
        ("a: &x {p: 1, q: 2}\nb: {<<: *x, q: 3}", {"a": {"p": 1, "q": 2}, "b": {"p": 1, "q": 3}}),
        ("a: {<<: [{p: 1}, {p: 2, q: 3}]}", {"a": {"p": 1, "q": 3}}),
        ("a: &x [1]\nb: *x", {"a": [1], "b": [1]}),
        ("'<<': 1", {"<<": 1}),
        ("{2, 5}", {"2": None, "5": None}),
        ("[{2, b}, 1]", [{"2": None, "b": None}, 1]),
    ],
)
def test_yaml_as_values(text: str, value: object) -> None:
    read = read_tree(text, "f").value
    assert read == value
    assert type(read) is type(value)


def test_not_a_number() -> None:
    assert math.isnan(read_tree(".nan", "f").value)


def test_every_value_has_its_line() -> None:
    tree = read_tree("# head\na: 1\nb:\n  c:\n    - x\n    - {d: 2}\n", "f")
    assert tree.lines == {
        (): 2,
        ("a",): 2,
        ("b",): 3,
        ("b", "c"): 4,
        ("b", "c", 0): 5,
        ("b", "c", 1): 6,
        ("b", "c", 1, "d"): 6,
    }


def test_an_edge_is_written_one_way() -> None:
    tree = read_tree("edges:\n  a->b: 1\n  b  ->  c: 2\n", "f")
    assert tree.value == {"edges": {"a -> b": 1, "b -> c": 2}}
    assert tree.lines["edges", "b -> c"] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", "f:3: a: given twice, in line 1 and in line 3"),
        ("edges:\n  a->b: 1\n  a -> b: 2", "f:3: edges.a -> b: given twice, in line 2 and in line 3"),
        ("a:\n  - {b: 1, b: 2}", "f:2: a[0].b: given twice, in line 2 and in line 2"),
        ("a: [1\nb: 2", "f:2: no valid YAML: expected ',' or ']', but got ':' while parsing a flow sequence"),
        ("a:\n\tb: 1", "f:2: no valid YAML: found character '\\t' that cannot start any token"),
        ("a: 'x", "f:1: no valid YAML: found unexpected end of stream while scanning a quoted scalar"),
        ("a: *x", "f:1: no valid YAML: found undefined alias 'x'"),
        ("a: 1\n---\nb: 2", "f:2: no valid YAML: but found another document"),
        ("a: 1\nb: \x00", "f:2: character '\\x00' is not allowed in YAML"),
        ("a: \x07", "f:1: character '\\x07' is not allowed in YAML"),
        ("a:\n  1: x", "f:2: a: a key must be text, not 1; put quotes around it"),
        ("a: {1: x}", "f:1: a: a key must be text, not 1; put quotes around it"),
        ("a: {1: null}", "f:1: a: a key must be text, not 1; put quotes around it"),
        ("a: {1, 1}", "f:1: a.1: given twice, in line 1 and in line 1"),
        ("a:\n  1:", "f:2: a: a key must be text, not 1; put quotes around it"),
        ("a:\n  true: x", "f:2: a: a key must be text, not true; put quotes around it"),
        ("? [a]\n: x", "f:1: a key must be text, not a list or a map; put quotes around it"),
        ("a: !!python/name:os.system x", "f:1: a: the tag !!python/name:os.system cannot be used here"),
        ("a: !!set {x}", "f:1: a: the tag !!set cannot be used here"),
        ("a: !mine [x]", "f:1: a: the tag !mine cannot be used here"),
        ("a: !!int x", "f:1: a: 'x' is no !!int"),
        ("a: !!bool on", "f:1: a: 'on' is no !!bool: expected true or false"),
        ("a: !!null x", "f:1: a: 'x' is no !!null: expected null"),
        ("a: !!binary '***'", "f:1: a: '***' is no !!binary"),
        ("a: 18446744073709551616", "f:1: a: '18446744073709551616' is no !!int: expected a whole number of 64 bits"),
        ("a: " + "9" * 5000, "expected a whole number of 64 bits"),
        ('a: "\\ud800"', "is no !!str"),
        (
            'a: 1\nb: "\\U00110000"',
            "f:2: no valid YAML: found a number that is too large; that of a character is 10FFFF",
        ),
        (
            'a: 1\nb: "\\UFFFFFFFF"',
            "f:2: no valid YAML: found a number that is too large; that of a character is 10FFFF",
        ),
        ("%YAML " + "9" * 5000 + "\n---\na: 1", "f:1: no valid YAML: found a number that is too large"),
        ("a: {<<: 1}", "f:1: a: '<<' takes a map, or a list of maps"),
        ("a: &x {<<: {b: 1}}\nc: {<<: *x}", "f:1: c: '<<' takes a map that has no '<<' itself"),
        ("a: &x {b: *x}", f"f:1: a.b.b.b: nested deeper than {MAX_DEPTH} levels"),
        ("[" * 5000, f"f: nested deeper than {MAX_DEPTH} levels"),
        ("[" * (MAX_DEPTH + 2) + "]" * (MAX_DEPTH + 2), f"nested deeper than {MAX_DEPTH} levels"),
        (
            "a: &a [x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\n"
            "d: &d [*c,*c,*c,*c,*c,*c,*c,*c]\ne: &e [*d,*d,*d,*d,*d,*d,*d,*d]\nf: [*e,*e,*e,*e,*e,*e,*e,*e]\n",
            f"the document has more than {MAX_PARTS} values",
        ),
        (" " * (MAX_TEXT_CHARS + 1), f"f: has {MAX_TEXT_CHARS + 1} characters; at most {MAX_TEXT_CHARS} are allowed"),
    ],
)
def test_what_is_refused(text: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        read_tree(text, "f")
    assert message in str(caught.value)


def test_a_place_without_lines() -> None:
    with pytest.raises(DeploymentError) as caught:
        read_tree("[1", "--set a=[1", has_lines=False)
    assert str(caught.value).startswith("--set a=[1: no valid YAML: expected ',' or ']', but got the end of the text")
    with pytest.raises(DeploymentError, match=r"^--set a=…: no valid YAML: found a number that is too large"):
        read_tree('"\\UFFFFFFFF"', "--set a=…", has_lines=False)


def refusal(text: str) -> str:
    """The message of the error that reading raises; the file's name where it raises none."""
    try:
        read_tree(text, "f")
    except DeploymentError as error:
        return str(error)
    return "f"


@given(st.text() | st.text("[]{}:-,&*!|>'\"#%@<? \n\tab01"))
def test_any_text_is_read_or_refused(text: str) -> None:
    assert refusal(text).startswith("f")


def test_what_merges_bring_in_counts() -> None:
    """A text of some hundred kilobytes that would have a thousand million entries."""
    wide = ", ".join(f"k{number}: 1" for number in range(5000))
    text = f"a: &a {{{wide}}}\nb: {{<<: [{', '.join(['*a'] * 20_000)}]}}\n"
    with pytest.raises(DeploymentError, match=f"the document has more than {MAX_PARTS} values"):
        read_tree(text, "f")


def test_reading_stops_at_what_is_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not at the end of a text that is a list of millions."""
    monkeypatch.setattr("hierax.runtime.deployment.tree.MAX_PARTS", 1000)
    text = "[" + "1," * 3000 + '"never read\n'
    with pytest.raises(DeploymentError, match="the document has more than 1000 values"):
        read_tree(text, "f")
