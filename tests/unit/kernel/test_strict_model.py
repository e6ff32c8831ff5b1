from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Discriminator, Field, PositiveFloat, Tag, TypeAdapter, ValidationError, field_validator

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1, problems_from
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import parse_yaml


class Drive(StrictModel):
    drive: float
    speed_m_s: PositiveFloat = 0.2


class Turn(StrictModel):
    turn: float
    left: bool = True


def step_kind(value: object) -> str | None:
    keys = value if isinstance(value, dict) else {}
    return "Drive" if "drive" in keys else "Turn" if "turn" in keys else None


Step = Annotated[
    Annotated[Drive, Tag("Drive")] | Annotated[Turn, Tag("Turn")],
    Discriminator(step_kind, custom_error_type="no_step", custom_error_message="has neither 'drive' nor 'turn'"),
]


class Lamp(StrictModel):
    kind: Literal["lamp"]
    watts: int = Field(gt=0, le=100)


class Horn(StrictModel):
    kind: Literal["horn"]
    tune: Literal["low", "high"]


class Inner(StrictModel):
    even: int = 0
    label: str = Field(default="ab", min_length=2, max_length=3)

    @field_validator("even")
    @classmethod
    def _check_even(cls, value: int) -> int:
        if value % 2:
            raise ValueError(f"must be even, not {value}")
        return value


class Top(StrictModel):
    version: Version1
    name: Name = "x"
    pair: tuple[int, float] = Field(default=(1, 2.0), strict=False)
    steps: tuple[Step, ...] = Field(default=(), strict=False)
    parts: tuple[Annotated[Lamp | Horn, Field(discriminator="kind")], ...] = Field(default=(), strict=False)
    inner: Inner | None = None
    table: dict[Name, dict[str, Inner]] = Field(default={}, json_schema_extra=NAMES_ONLY)
    mixed: float | str | None = None
    either: Inner | dict[str, Drive] | None = None
    some: tuple[int, ...] = Field(default=(1,), min_length=1, strict=False)
    flag: bool = False
    rename: int = Field(default=1, alias="as")


def lines(text: str) -> list[str]:
    tree = parse_yaml(f"version: 1\n{text}", "f.yaml")
    with pytest.raises(ValidationError) as caught:
        Top.model_validate(tree.root)
    return [str(problem) for problem in problems_from(caught.value, tree, Top)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("steps: [{drive: 1, speeed: 2}]", "2:20: steps[0].speeed: unknown key 'speeed'; did you mean 'speed_m_s'?"),
        ("steps: [{drive: 1, xyz: 2}]", "2:20: steps[0].xyz: unknown key 'xyz'; known: drive, speed_m_s"),
        ("steps: [{turn: 1, drive: 1}]", "2:10: steps[0].turn: unknown key 'turn'; known: drive, speed_m_s"),
        ("steps: [{turn: 1, left: yes}]", "2:25: steps[0].left: must be true or false, not 'yes'"),
        ("steps: [{}]", "2:9: steps[0]: has neither 'drive' nor 'turn'"),
        ("steps: [{drive: 1, speed_m_s: 0}]", "2:31: steps[0].speed_m_s: must be over 0, not 0"),
        ("parts: [{kind: lamp}]", "2:9: parts[0].watts: is missing"),
        ("parts: [{kind: lamp, watts: 101}]", "2:29: parts[0].watts: must be at most 100, not 101"),
        ("parts: [{kind: lamp, wats: 1, watts: 1}]", "2:22: parts[0].wats: unknown key 'wats'; did you mean 'watts'?"),
        (
            "parts: [{kind: lmap}]",
            "2:16: parts[0].kind: must be one of 'lamp', 'horn', not 'lmap'; did you mean 'lamp'?",
        ),
        ("parts: [{}]", "2:9: parts[0]: lacks 'kind', which tells what it is"),
        ("parts: [5]", "2:9: parts[0]: must be a mapping, not 5"),
        (
            "parts: [{kind: horn, tune: hihg}]",
            "2:28: parts[0].tune: must be 'low' or 'high', not 'hihg'; did you mean 'high'?",
        ),
        ("inner: {lable: x}", "2:9: inner.lable: unknown key 'lable'; did you mean 'label'?"),
        ("inner: {even: 3}", "2:15: inner.even: must be even, not 3"),
        ("inner: {label: x}", "2:16: inner.label: must have at least 2 characters, not 'x'"),
        ("inner: {label: xxxx}", "2:16: inner.label: must have at most 3 characters, not 'xxxx'"),
        ("inner: []", "2:8: inner: must be a mapping, not a list"),
        ("table: {a: {b: {evn: 1}}}", "2:17: table.a.b.evn: unknown key 'evn'; did you mean 'even'?"),
        ("table: {a: }", "2:11: table.a: must be a mapping; write {} for an empty one"),
        (
            "table: {1a: {}}",
            "2:9: table.1a: '1a' is not a name: a name is a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'",
        ),
        ("pair: [1]", "2:7: pair[1]: is missing"),
        ("pair: [1, 2, 3]", "2:7: pair: has 3 items, but may have at most 2"),
        ("pair: 5", "2:7: pair: must be a list, not 5"),
        ("pair: ['1', 2]", "2:8: pair[0]: must be a whole number, not '1'"),
        ("pair: [1, true]", "2:11: pair[1]: must be a number, not true"),
        ("some: []", "2:7: some: has 0 items, but needs at least 1"),
        ("flag: 1", "2:7: flag: must be true or false, not 1"),
        ("name: 5", "2:7: name: must be text, not 5; put it in quotes if it is meant as text"),
        ("as: 1.0", "2:5: as: must be a whole number, not 1.0"),
        ("ass: 1", "2:1: ass: unknown key 'ass'; did you mean 'as'?"),
    ],
)
def test_a_problem_in_plain_words(text: str, expected: str) -> None:
    assert lines(text) == [f"f.yaml:{expected}"]


def test_each_form_of_a_union_is_named_once() -> None:
    assert lines("mixed: true") == [
        ("f.yaml:2:8: mixed: must be a number or text, not true; put it in quotes if it is meant as text")
    ]


def test_keys_are_suggested_in_a_mapping_of_models() -> None:
    assert lines("either: {a: {drive: 1, sped_m_s: 1}}")[-1] == (
        "f.yaml:2:24: either.a.sped_m_s: unknown key 'sped_m_s'; did you mean 'speed_m_s'?"
    )


@pytest.mark.parametrize(("version", "shown"), [("true", "true"), ("2", "2"), ("'1'", "'1'")])
def test_the_version_is_exactly_one(version: str, shown: str) -> None:
    tree = parse_yaml(f"version: {version}", "f.yaml")
    with pytest.raises(ValidationError) as caught:
        Top.model_validate(tree.root)

    (problem,) = problems_from(caught.value, tree, Top)

    assert str(problem) == f"f.yaml:1:10: version: must be 1, not {shown}"


def test_an_annotation_serves_as_well_as_a_model() -> None:
    tree = parse_yaml("drive: 1\nspeeed: 2", "f.yaml")
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Step).validate_python(tree.root)

    (problem,) = problems_from(caught.value, tree, Step)

    assert str(problem) == "f.yaml:2:1: speeed: unknown key 'speeed'; did you mean 'speed_m_s'?"


def test_integers_stand_for_floats_and_models_do_not_change() -> None:
    drive = Drive.model_validate({"drive": 1})

    assert isinstance(drive.drive, float)
    with pytest.raises(ValidationError, match="frozen"):
        drive.drive = 2.0


@pytest.mark.parametrize(
    ("word", "choices", "hint"),
    [
        ("evbot3", ["evbot2", "roomba"], "; did you mean 'evbot2'?"),
        ("x", ["b", "a"], "; known: a, b"),
        ("x", [f"name{n}" for n in range(13)], ""),
        ("x", [], ""),
    ],
)
def test_a_hint_names_the_nearest_choice_or_the_few_there_are(word: str, choices: list[str], hint: str) -> None:
    assert did_you_mean(word, choices) == hint
