"""The base of every model of a file, and plain messages for the errors that pydantic finds."""

from __future__ import annotations

import ast
import inspect
import os
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from types import UnionType
from typing import Annotated, Any, ClassVar, Final, Literal, TypeVar, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Tag,
    ValidationError,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema
from typing_extensions import override

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.suggestions import did_you_mean as did_you_mean
from eal_actors.kernel.suggestions import nearest
from eal_actors.kernel.yaml_tree import MarkedDict, MarkedList, YamlPath, YamlTree, show

NAME_PATTERN: Final = r"^[A-Za-z][A-Za-z0-9_.-]*$"
NAME_TEMPLATE_PATTERN: Final = r"^[A-Za-z]([A-Za-z0-9_.-]|\{n\})*$"


_NAME_WORDS: Final = "a name is a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'"
_PATTERN_WORDS: Final = {NAME_PATTERN: _NAME_WORDS, NAME_TEMPLATE_PATTERN: f"{_NAME_WORDS}, with {{n}} for a number"}
_MUST_BE: Final = re.compile(r"must be (?P<kind>.+?), not (?P<value>'.*?'|[^;]+)(?P<hint>;.*)?")
_MAPPING_KINDS: Final = ("dict_type", "model_type", "model_attributes_type")
_WORDS: Final = {
    "missing": "is missing",
    "string_type": "must be text, not {value}; put it in quotes if it is meant as text",
    "int_type": "must be a whole number, not {value}",
    "float_type": "must be a number, not {value}",
    "bool_type": "must be true or false, not {value}",
    "none_required": "must be left empty, not {value}",
    **dict.fromkeys(_MAPPING_KINDS, "must be a mapping, not {value}"),
    "list_type": "must be a list, not {value}",
    "tuple_type": "must be a list, not {value}",
    "greater_than": "must be over {gt}, not {value}",
    "greater_than_equal": "must be at least {ge}, not {value}",
    "less_than": "must be under {lt}, not {value}",
    "less_than_equal": "must be at most {le}, not {value}",
    "multiple_of": "must be a multiple of {multiple_of}, not {value}",
    "string_pattern_mismatch": "must match the pattern {pattern}, not {value}",
    "string_too_short": "must have at least {min_length} characters, not {value}",
    "string_too_long": "must have at most {max_length} characters, not {value}",
    "too_short": "has {actual_length} items, but needs at least {min_length}",
    "too_long": "has {actual_length} items, but may have at most {max_length}",
    "union_tag_not_found": "lacks {discriminator}, which tells what it is",
}


_BUILDING: Final = threading.RLock()

if hasattr(os, "register_at_fork"):  # a child would lack the thread that holds pydantic's own locks
    os.register_at_fork(before=_BUILDING.acquire, after_in_parent=_BUILDING.release, after_in_child=_BUILDING.release)


class StrictModel(BaseModel):
    """A section of a file: no unknown keys, no conversions (`"5"` is no number, `true` neither), no changes later.

    A float field accepts an integer. Declare a sequence as `tuple[X, ...]` with `Field(strict=False)`, because YAML
    knows only lists. The docstring under a field is its description in the JSON Schema.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        defer_build=True,  # a program uses few of the models that it imports, and building one takes milliseconds
    )
    synonyms: ClassVar[Mapping[str, str]] = {}
    """Keys that people write by mistake, and what they mean."""

    @classmethod
    @override
    def model_rebuild(cls, **options: Any) -> bool | None:
        """Build the model, which pydantic does at its first use; a fork waits until it is built."""
        depth = options.pop("_parent_namespace_depth", 2) + 1  # pydantic looks for names in the caller's frame
        with _BUILDING:
            return super().model_rebuild(_parent_namespace_depth=depth, **options)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in _field_docs(cls).items():
            key = cls.model_fields[name].alias or name
            if key in properties:
                properties[key].setdefault("description", text)
        return schema


def _field_docs(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings under the fields of a model, its own before those of its bases."""
    docs: dict[str, str] = {}
    for base in reversed(model.__mro__):
        docs |= _module_docs(base.__module__).get(base.__qualname__, {})
    return {name: text for name, text in docs.items() if name in model.model_fields}


@cache
def _module_docs(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings under the attributes of a module's classes; none where a module has no source."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):  # a robot's image has compiled files alone
        return {}
    return {node.name: _attribute_docs(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _attribute_docs(node: ast.ClassDef) -> dict[str, str]:
    return {
        field.target.id: inspect.cleandoc(doc.value.value)
        for field, doc in pairwise(node.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(doc, ast.Expr)
        and isinstance(doc.value, ast.Constant)
        and isinstance(doc.value.value, str)
    }


class DeferredType:
    """An annotation whose type is found when a model with it is built, after modules that import that model."""

    def __init__(self, find: Callable[[], object]) -> None:
        self.find = find

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return handler.generate_schema(self.find())


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):  # Python's True equals 1, and pydantic's Literal agrees
        raise ValueError(f"must be 1, not {show(value)}")
    return value


Version1 = Annotated[Literal[1], BeforeValidator(_refuse_boolean)]
"""The version of a file format that has only had one so far."""

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
"""The name of a robot, a type, a plugin or a resource."""

NameTemplate = Annotated[str, Field(pattern=NAME_TEMPLATE_PATTERN)]
"""A name in which `{n}` may stand for a number."""

Model = TypeVar("Model", bound=BaseModel)

NAMES_ONLY: Final[dict[str, Any]] = {"additionalProperties": False}
"""`json_schema_extra` of a `dict[Name, X]`: pydantic's own schema would let other keys pass unchecked."""


def model_of(model: type[Model], tree: YamlTree) -> Model:
    """Return the content of a file, or of a part of it, as a model; ConfigError with every problem of the content."""
    try:
        return model.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, model)) from None


def schema_of(model: type[StrictModel]) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}


def problems_from(error: ValidationError, tree: YamlTree, model: object) -> list[Problem]:
    """Convert pydantic's errors into problems with a place in the file.

    `tree` is the validated part of a file, `model` what it was validated against: a model, or the annotation given to a
    TypeAdapter. Each place has one problem; if a value may have several forms, it names them all.
    """
    found: dict[tuple[YamlPath, bool], list[str]] = {}
    for detail in error.errors(include_url=False):
        path, annotations = _resolve(detail["loc"], tree, model)
        kind, about_key = detail["type"], False
        if kind == "missing":
            path = (*path, detail["loc"][-1])
        elif kind == "union_tag_invalid" and not detail["ctx"]["discriminator"].endswith("()"):
            path = (*path, detail["ctx"]["discriminator"].strip("'"))
        elif kind == "extra_forbidden" or detail["loc"][-1:] == ("[key]",):
            about_key = True
        messages = found.setdefault((path, about_key), [])
        message = wording_of(detail, annotations)
        if message not in messages:
            messages.append(message)
    return [tree.problem(path, _alternatives(messages), key=key) for (path, key), messages in found.items()]


def _alternatives(messages: list[str]) -> str:
    """Return the messages about one value as one: `must be text or a list, not 5`."""
    parts = [_MUST_BE.fullmatch(message) for message in messages]
    shown = {part["value"] for part in parts if part is not None}
    if len(messages) < 2 or None in parts or len(shown) != 1:
        return "; or ".join(messages)
    kinds = dict.fromkeys(part["kind"] for part in parts if part is not None)
    hints = dict.fromkeys(part["hint"] or "" for part in parts if part is not None)
    return f"must be {' or '.join(kinds)}, not {shown.pop()}{''.join(hints)}"


def _resolve(loc: tuple[int | str, ...], tree: YamlTree, model: object) -> tuple[YamlPath, list[object]]:
    """Return the path in the file of a pydantic `loc`, and the annotations around its last element."""
    path: list[int | str] = []
    node: object = tree.root
    around: list[object] = []
    here = _choices(model)
    for position, element in enumerate(loc):
        is_last = position == len(loc) - 1
        tagged = [choice for choice in here if element in _labels(choice)] if len(here) > 1 else []
        if tagged and not is_last:
            here = tagged
            continue
        has_element = isinstance(node, MarkedDict) and element in node
        has_item = isinstance(node, MarkedList) and isinstance(element, int) and element < len(node)
        if has_element or has_item:
            path.append(element)
            around, here = here, [inner for choice in here for inner in _inside(choice, element)]
            node = node[element]  # type: ignore[index]
        elif is_last:
            around = here
    return tuple(path), around


def _choices(annotation: object) -> list[object]:
    """Return the annotations that a value may follow, without None, and tags still around them."""
    annotation = getattr(annotation, "__value__", annotation)  # a `type` alias
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *extras = get_args(annotation)
        if extras and isinstance(extras[0], DeferredType):
            return _choices(extras[0].find())
        return [annotation] if any(isinstance(extra, Tag) for extra in extras) else _choices(inner)
    if origin in (Union, UnionType):
        return [choice for part in get_args(annotation) for choice in _choices(part)]
    return [] if annotation is type(None) else [annotation]


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    model.model_rebuild()  # if it was never built, its references to other models are unresolved
    return model.model_fields


def _untagged(choice: object) -> object:
    return get_args(choice)[0] if get_origin(choice) is Annotated else choice


def _labels(choice: object) -> set[object]:
    """Return pydantic's possible names of a union's member in a `loc`."""
    labels: set[object] = {extra.tag for extra in getattr(choice, "__metadata__", ()) if isinstance(extra, Tag)}
    bare = _untagged(choice)
    labels.add(getattr(bare, "__name__", None))
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        for field in _fields(bare).values():
            if get_origin(field.annotation) is Literal:
                labels.update(get_args(field.annotation))
    return labels


def _inside(choice: object, element: int | str) -> list[object]:
    """Return the annotations of a value's key or index."""
    bare = _untagged(choice)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        for name, field in _fields(bare).items():
            if element in (name, field.alias):
                return _choices(field.annotation)
        return []
    arguments = get_args(bare)
    origin = get_origin(bare)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _choices(arguments[1]) if len(arguments) == 2 else []
    if isinstance(element, int) and arguments:
        varied = origin is tuple and Ellipsis not in arguments
        return _choices(arguments[min(element, len(arguments) - 1)] if varied else arguments[0])
    return []


def _known_keys(annotations: Sequence[object]) -> list[str]:
    models = [_untagged(choice) for choice in annotations]
    return [
        field.alias or name
        for model in models
        if isinstance(model, type) and issubclass(model, BaseModel)
        for name, field in _fields(model).items()
    ]


def wording_of(detail: Mapping[str, Any], annotations: Sequence[object] = ()) -> str:
    """Return pydantic's error about one value in our words; the annotations around it give the known keys."""
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    if kind == "extra_forbidden":
        key = str(detail["loc"][-1])
        for choice in map(_untagged, annotations):
            if isinstance(choice, type) and issubclass(choice, StrictModel) and key in choice.synonyms:
                return f"unknown key '{key}'; did you mean '{choice.synonyms[key]}'?"
        return f"unknown key '{key}'{did_you_mean(key, _known_keys(annotations))}"
    if kind in ("value_error", "assertion_error"):
        return str(context.get("error", detail["msg"]))
    if context.get("pattern") in _PATTERN_WORDS:
        return f"{show(value)} is not a name: {_PATTERN_WORDS[context['pattern']]}"
    if kind in ("literal_error", "enum"):
        return f"must be {context['expected']}, not {show(value)}{_nearest(value, context['expected'])}"
    if kind == "union_tag_invalid":
        tag, expected = context["tag"], context["expected_tags"]
        return f"must be one of {expected}, not '{tag}'{_nearest(tag, expected)}"
    if value is None and kind in _MAPPING_KINDS:
        return "must be a mapping; write {} for an empty one"
    if kind in _WORDS:
        limits = {name: _without_fraction(limit) for name, limit in context.items()}
        return _WORDS[kind].format(value=show(value), **limits)
    message = str(detail["msg"])
    return message[:1].lower() + message[1:]


def _nearest(value: object, expected: str) -> str:
    near = nearest(value, re.findall(r"'([^']*)'", expected)) if isinstance(value, str) else None
    return f"; did you mean '{near}'?" if near else ""


def _without_fraction(value: object) -> object:
    return int(value) if isinstance(value, float) and value.is_integer() else value
