from __future__ import annotations

import copy
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, MarkedList, YamlTree, format_path, merge, replace_text


class TestMarks:
    TREE = parse_yaml("a:\n  b: [10, {c: x}]\n  d:\ne: 1\n", "f.yaml")

    @pytest.mark.parametrize(
        ("path", "key", "line", "column"),
        [
            ((), False, 1, 1),
            (("a",), False, 2, 3),
            (("a",), True, 1, 1),
            (("a", "b", 0), False, 2, 7),
            (("a", "b", 1, "c"), False, 2, 15),
            (("a", "b", 1, "c"), True, 2, 12),
            (("a", "b", "some tag", 1, "Model", "c"), False, 2, 15),
            (("a", "missing"), False, 2, 3),
            (("a", "missing"), True, 2, 3),
            (("a", "b", 7), False, 2, 6),
            (("e", "int"), False, 4, 4),
        ],
    )
    def test_a_path_leads_to_a_place(self, path: tuple[str | int, ...], key: bool, line: int, column: int) -> None:
        assert self.TREE.mark_at(path, key=key) == Mark("f.yaml", line, column)

    def test_a_problem_names_the_place_and_the_whole_path(self) -> None:
        part = YamlTree(self.TREE.root["a"], ("a",))

        assert str(part.problem(("b", 1, "c"), "is odd")) == "f.yaml:2:15: a.b[1].c: is odd"

    def test_paths_are_written_with_dots_and_brackets(self) -> None:
        assert format_path(("a", 0, 1, "b", "c.d")) == "a[0][1].b.c.d"

    def test_marks_survive_copies(self) -> None:
        for tree in (copy.deepcopy(self.TREE), pickle.loads(pickle.dumps(self.TREE))):  # noqa: S301
            assert tree.root == self.TREE.root
            assert tree.mark_at(("a", "b", 1, "c")) == Mark("f.yaml", 2, 15)


def marked(value: object, file: str = "f") -> object:
    """Return a plain value with marks that all name one file."""
    mark = Mark(file, 1, 1)
    if isinstance(value, dict):
        mapping = MarkedDict(mark)
        for key, item in value.items():
            mapping.put(key, marked(item, file), mark, mark)
        return mapping
    if isinstance(value, list):
        items = MarkedList(mark)
        for item in value:
            items.put(marked(item, file), mark)
        return items
    return value


def mappings(depth: int = 3) -> st.SearchStrategy[dict[str, object]]:
    """Make mappings whose keys tell what they hold: a capital a mapping, a small letter a value."""
    leaves: st.SearchStrategy[object] = st.one_of(st.integers(), st.lists(st.integers(), max_size=2))
    small: st.SearchStrategy[dict[str, object]] = st.dictionaries(st.sampled_from("abc"), leaves)
    if depth == 0:
        return small
    large = st.dictionaries(st.sampled_from("ABC"), mappings(depth - 1))
    return st.builds(lambda one, two: {**one, **two}, small, large)


def as_marked(value: object, file: str = "f") -> MarkedDict:
    mapping = marked(value, file)
    assert isinstance(mapping, MarkedDict)
    return mapping


class TestMerge:
    def test_mappings_merge_and_all_else_is_replaced(self) -> None:
        base = as_marked({"a": {"x": 1, "y": [1, 2]}, "b": {"z": 1}, "c": 1})
        over = as_marked({"a": {"y": [3]}, "b": 5, "c": {"w": 1}, "d": None})

        assert merge(base, over) == {"a": {"x": 1, "y": [3]}, "b": 5, "c": {"w": 1}, "d": None}

    def test_every_value_keeps_the_mark_of_its_file(self) -> None:
        merged = YamlTree(merge(as_marked({"a": {"x": 1, "y": 1}}, "base"), as_marked({"a": {"y": 2}}, "over")))

        assert merged.mark_at(("a", "x")).file == "base"
        assert merged.mark_at(("a", "y")).file == "over"
        assert merged.mark_at(("a",)).file == "over"

    @given(mappings(), mappings(), mappings())
    def test_the_order_of_merging_does_not_matter(
        self, a: dict[str, object], b: dict[str, object], c: dict[str, object]
    ) -> None:
        one, two, three = as_marked(a), as_marked(b), as_marked(c)

        assert merge(merge(one, two), three) == merge(one, merge(two, three))

    @given(mappings(), mappings())
    def test_the_last_value_wins_and_nothing_is_lost(self, a: dict[str, object], b: dict[str, object]) -> None:
        merged = merge(as_marked(a, "a"), as_marked(b, "b"))

        assert merged.keys() == a.keys() | b.keys()
        for key in filter(str.islower, merged):
            assert merged[key] == (b if key in b else a)[key]
            assert merged.value_marks[key].file == ("b" if key in b else "a")

    @given(mappings(), mappings())
    def test_merging_leaves_its_arguments_alone(self, a: dict[str, object], b: dict[str, object]) -> None:
        one, two = as_marked(a), as_marked(b)

        merge(one, two)

        assert (one, two) == (a, b)

    def test_text_is_replaced_at_every_depth_but_not_in_keys(self) -> None:
        tree = parse_yaml("x: [x, {x: x}, 1]", "f.yaml")

        replaced = YamlTree(replace_text(tree.root, lambda text: text.upper()))

        assert replaced.root == {"x": ["X", {"x": "X"}, 1]}
        assert replaced.mark_at(("x", 1, "x")) == tree.mark_at(("x", 1, "x"))
