from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import load_yaml, parse_yaml, plain_value
from eal_actors.kernel.yaml_tree import Mark
from tests.problems import problem_texts

NO_TAGS = " is not supported; leave it out, and put text in quotes"
UNCLOSED_LIST = "a ']' is missing at the end of the list that begins in line 1"
BARE_REFERENCE = (
    "a ',' or '}' is missing in the mapping that begins in line 1; "
    "inside [...] and {...} a ${NAME} must stand in quotes, or write the value on a line of its own"
)


def problems(text: str | bytes, environment: Mapping[str, str] | None = None) -> list[str]:
    return problem_texts(lambda: parse_yaml(text, "f.yaml", environment=environment))


def values(text: str, environment: Mapping[str, str] | None = None) -> dict[str, object]:
    return dict(parse_yaml(text, "f.yaml", environment=environment).root)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("on", "on"),
        ("n", "n"),
        ("", None),
        ("~", None),
        ("null", None),
        ("0", 0),
        ("-12", -12),
        ("+3", 3),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("9223372036854775807", 2**63 - 1),
        ("1e3", 1000.0),
        ("-1.5E-2", -0.015),
        (".5", 0.5),
        ("1.", 1.0),
        ("12:30", "12:30"),
        ("190:20:30", "190:20:30"),
        ("2024-01-01", "2024-01-01"),
        ("1.2.3", "1.2.3"),
        ("tRue", "tRue"),
        ("٣", "٣"),
    ],
)
def test_plain_scalars_follow_the_core_schema(text: str, value: object) -> None:
    found = values(f"key: {text}")["key"]

    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("text", ["'5'", '"5"', "|-\n  5", ">-\n  5"])
def test_a_quoted_scalar_is_text(text: str) -> None:
    assert values(f"key: {text}") == {"key": "5"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: .inf", "f.yaml:1:4: a: .inf is not a finite number; put it in quotes if it is meant as text"),
        ("a: -.INF", "f.yaml:1:4: a: -.INF is not a finite number; put it in quotes if it is meant as text"),
        ("a: .NaN", "f.yaml:1:4: a: .NaN is not a finite number; put it in quotes if it is meant as text"),
        ("a: 1e999", "f.yaml:1:4: a: 1e999 is too large for a number"),
        ("a: 9223372036854775808", "f.yaml:1:4: a: the number does not fit into 64 bits"),
        ("a: " + "9" * 10_000, "f.yaml:1:4: a: the number does not fit into 64 bits"),
        ("a: 1\nb: {a: 1, a: 2}", "f.yaml:2:11: b.a: duplicate key; first defined in line 2"),
        ('a: 1\n"a": 2', "f.yaml:2:1: a: duplicate key; first defined in line 1"),
        ("a: {5: x}", "f.yaml:1:5: a: a key must be text, and 5 is not; write it in quotes: '5'"),
        (
            "a: {b: -1,5, c: 2}",
            "f.yaml:1:11: a: a key must be text, and 5 is not; a decimal number has a point, not a comma",
        ),
        ("true: x", "f.yaml:1:1: a key must be text, and true is not; write it in quotes: 'true'"),
        (".inf: x", "f.yaml:1:1: a key must be text, and .inf is not; write it in quotes: '.inf'"),
        ("? \n: x", "f.yaml:1:2: a key must be text, and this one is empty"),
        ("? [a, b]\n: x", "f.yaml:1:3: a key must be text, not a list or mapping"),
        (
            "a: &a {x: 1}\nb:\n  <<: *a",
            "f.yaml:3:3: b: merge keys (<<) are not supported; share settings through `types` or `include`",
        ),
        (
            "a: !thing 5",
            f"f.yaml:1:4: the tag !thing{NO_TAGS}",
        ),
        (
            "a: !!python/object/apply:os.getcwd []",
            f"f.yaml:1:4: the tag tag:yaml.org,2002:python/object/apply:os.getcwd{NO_TAGS}",
        ),
        ("a: &x [1, *x]", "f.yaml:1:4: a[1]: the anchor contains itself"),
        ("a: *nowhere", "f.yaml:1:4: not valid YAML: found undefined alias 'nowhere'"),
        ("a: 1\n---\nb: 2", "f.yaml:2:1: a second document starts here; one file holds one document"),
        ("a:\n\tb: 1", "f.yaml:2:1: YAML does not allow a tab here; use spaces"),
        ("a: b: c", "f.yaml:1:5: a second ': ' in one line: put the value in quotes, or begin a new line"),
        ("a: 1\nb 2\nc: 3", "f.yaml:2:2: a ':' is missing after 'b'"),
        ("a: 1\nb:2\nc: 3", "f.yaml:2:3: a space is missing after the ':' in 'b:2'"),
        ("a: 1\nb\n  c: 3", "f.yaml:2:2: a ':' is missing after 'b'"),
        (
            "a: x\n  b: 2",
            "f.yaml:2:3: the line is indented below 'a', which has a value already: begin it in column 1",
        ),
        ("a:\n  b: 1\n c: 2", "f.yaml:3:2: the indentation fits no line above: begin the line in column 1 or 3"),
        ("a:\n    b: 1\n   c: 2", "f.yaml:3:4: the indentation fits no line above: begin the line in column 1 or 5"),
        ("a:\n  - 1\n  b: 2", "f.yaml:3:3: a key stands among list items: all lines of a block begin alike"),
        ("a:\n  b: 2\n  - 1", "f.yaml:3:3: a list item stands among keys: all lines of a block begin alike"),
        ('a: 1\nb: "x\nc: 2\n', "f.yaml:2:4: the quote that begins here is not closed"),
        (
            'a: "x" y',
            "f.yaml:1:8: something follows a value that is complete: put all of it in quotes, or begin a new line",
        ),
        ("a: {b: 1, c: 2\nd: 3\n", "f.yaml:2:2: a ',' or '}' is missing in the mapping that begins in line 1"),
        ("a: @b", "f.yaml:1:4: a value cannot begin with @: put it in quotes"),
        (
            "a: [1, 2",
            f"f.yaml:1:9: {UNCLOSED_LIST}",
        ),
        (
            "a: {port: ${PORT}}",
            f"f.yaml:1:12: {BARE_REFERENCE}",
        ),
        ("a: x\x07", "f.yaml:1:5: the character U+0007 is not allowed in YAML"),
        ('a: "\\UFFFFFFFF"', "f.yaml:1:7: the escape is no valid character"),
        ('a: "\\ud800"', "f.yaml:1:4: a: the text holds half a character (a surrogate), which no file can store"),
        ("", "f.yaml: is empty; the top level must be a mapping of keys to values"),
        ("# only a comment\n", "f.yaml: is empty; the top level must be a mapping of keys to values"),
        ("---\n", "f.yaml: is empty; the top level must be a mapping of keys to values"),
        ("- a\n- b", "f.yaml:1:1: the top level must be a mapping of keys to values, not a list"),
        ("just text", "f.yaml:1:1: the top level must be a mapping of keys to values, not 'just text'"),
        ("a: " + "[" * 100, "f.yaml:1:67: is nested more than 64 levels deep"),
        (
            "a: [" + "1," * 20_001 + "]",
            "f.yaml:1:40001: the file has more than 20000 values, each use of an anchor counted",
        ),
        (b"a: 1\nb: \xff", "f.yaml:2:4: is not UTF-8: byte 0xff at offset 8"),
        ("a: 1".encode("utf-16"), "f.yaml:1:1: is not UTF-8: byte 0xff at offset 0"),
        (b"#" * 1_000_001, "f.yaml: is larger than 1000000 bytes"),
    ],
)
def test_what_is_wrong_with_a_file(text: str | bytes, expected: str) -> None:
    assert problems(text) == [expected]


def test_a_billion_laughs_are_stopped_early() -> None:
    lines = ["a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]

    (line,) = problems("\n".join(lines))

    assert line.endswith("the file has more than 20000 values, each use of an anchor counted")


def test_a_file_of_very_many_values_is_stopped_before_it_is_built() -> None:
    assert problems("a: [" + "1," * 45_000 + "]") == ["f.yaml:1:79999: has more than 20000 values"]


def test_all_problems_of_a_file_are_told_at_once() -> None:
    text = "a: 1\na: .inf\n5: x\nb: !tag y\nc: ${MISSING}\nd: {<<: {}}\n"

    assert problems(text, {}) == [
        "f.yaml:2:1: a: duplicate key; first defined in line 1",
        "f.yaml:2:4: a: .inf is not a finite number; put it in quotes if it is meant as text",
        "f.yaml:3:1: a key must be text, and 5 is not; write it in quotes: '5'",
        "f.yaml:4:4: the tag !tag is not supported; leave it out, and put text in quotes",
        "f.yaml:5:4: c: the environment variable MISSING is not set; set it, or give a default: ${MISSING:-default}",
        "f.yaml:6:5: d: merge keys (<<) are not supported; share settings through `types` or `include`",
    ]


def test_a_problem_in_an_anchor_counts_once() -> None:
    assert len(problems("a: &a [.inf]\nb: *a\nc: *a")) == 1


def test_anchors_are_allowed() -> None:
    tree = parse_yaml("a: &a {x: 1}\nb: *a", "f.yaml")

    assert tree.root == {"a": {"x": 1}, "b": {"x": 1}}
    assert tree.mark_at(("b", "x")) == Mark("f.yaml", 1, 11)


def test_a_byte_order_mark_does_not_count() -> None:
    assert parse_yaml(b"\xef\xbb\xbfa: 1", "f.yaml").mark_at(("a",), key=True) == Mark("f.yaml", 1, 1)


class TestFiles:
    def test_a_file_is_read_under_the_name_it_was_given(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "f.yaml").write_text("a: ü", encoding="utf-8")
        monkeypatch.chdir(tmp_path)

        tree = load_yaml("f.yaml")

        assert tree.root == {"a": "ü"}
        assert tree.root.mark == Mark("f.yaml", 1, 1)

    @pytest.mark.parametrize(("name", "message"), [("none.yaml", "no such file"), ("", "is a folder, not a file")])
    def test_what_is_no_file_is_refused(self, tmp_path: Path, name: str, message: str) -> None:
        with pytest.raises(ConfigError) as caught:
            load_yaml(tmp_path / name)

        assert str(caught.value) == f"{tmp_path / name}: {message}"

    def test_a_name_that_no_file_can_have_is_refused(self) -> None:
        with pytest.raises(ConfigError, match="cannot be read: File name too long"):
            load_yaml("x" * 5000)


class TestEnvironment:
    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("${PORT}", 50000),
            ("'${PORT}'", "50000"),
            ("port ${PORT}!", "port 50000!"),
            ("${PORT}${PORT}", "5000050000"),
            ("${NONE:-7}", 7),
            ("${NONE:-}", None),
            ("${EMPTY}", None),
            ("'${EMPTY}'", ""),
            ("${EMPTY:-set}", "set"),
            ("${URL:-tcp://host:1}", "tcp://host:1"),
            ("$${PORT}", "${PORT}"),
            ("'$${PORT} ${PORT}'", "${PORT} 50000"),
            ("$PORT", "$PORT"),
            ("${NESTED}", "${PORT}"),
            ("${ON}", "on"),
            ("${TRUE}", True),
        ],
    )
    def test_values_come_from_the_environment(self, text: str, value: object) -> None:
        environment = {"PORT": "50000", "EMPTY": "", "NESTED": "${PORT}", "ON": "on", "TRUE": "true"}

        found = values(f"key: {text}", environment)["key"]

        assert found == value
        assert type(found) is type(value)

    def test_without_an_environment_text_stays_as_it_is(self) -> None:
        assert values("a: ${PORT}\nb: $${PORT}\nc: ${oh no") == {"a": "${PORT}", "b": "$${PORT}", "c": "${oh no"}

    def test_keys_are_not_replaced(self) -> None:
        assert values("${PORT}: 1", {"PORT": "x"}) == {"${PORT}": 1}

    @pytest.mark.parametrize("text", ["${", "${}", "${PORT", "${1X}", "${a-b}", "${A:-{}}"])
    def test_what_looks_like_a_reference_must_be_one(self, text: str) -> None:
        assert problems(f"key: x {text}", {"PORT": "1"}) == [
            "f.yaml:1:6: key: ${ must go on as ${NAME} or ${NAME:-default}; write $${ for a literal ${"
        ]

    def test_a_number_from_the_environment_must_be_finite(self) -> None:
        assert problems("key: ${X}", {"X": ".inf"}) == [
            "f.yaml:1:6: key: .inf is not a finite number; put it in quotes if it is meant as text"
        ]

    @given(st.text(alphabet="ab${}:-N '\"", max_size=20))
    def test_escaped_text_comes_through_unchanged(self, text: str) -> None:
        quoted = text.replace("${", "$${").replace("'", "''")

        if "$${" not in text:  # `$$${` would escape the wrong dollar
            assert values(f"key: '{quoted}'", {}) == {"key": text}


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(ConfigError):  # anything else is a defect
        parse_yaml(text, "f.yaml", environment={})


@given(st.integers(min_value=-(2**63), max_value=2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_mean_themselves(number: float) -> None:
    assert plain_value(repr(number)) == number


def test_a_pipe_without_a_writer_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fleet.yaml")
    (problem,) = problem_texts(lambda: load_yaml(tmp_path / "fleet.yaml"))
    assert "is empty" in problem


def test_what_is_written_into_a_pipe_is_read(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.write(writing, b"version: 1")
    os.close(writing)
    assert load_yaml(f"/dev/fd/{reading}").root.keys() == {"version"}
    os.close(reading)
