"""Strict YAML reader: plain values, and errors for what YAML libraries silently let through.

Numbers are those of YAML 1.2 (section 10.3.2), as other programs read them, too: 012 is twelve and 5e-2 a
number, while YAML 1.1 takes the first for ten, the second for a word, and 1:30 for ninety. Merges (`<<`) are
no part of YAML 1.2, and a few lines of them can take for ever: they are refused.
"""

import re
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import yaml

# What PyYAML lets through, beside its own error, from a scalar that is not what its tag says (!!bool maybe),
# from a date that does not exist, from a number that has no room, and from an integer of thousands of digits.
YAML_ERRORS = (
    *(yaml.YAMLError, ValueError, TypeError, LookupError),
    *(AttributeError, ArithmeticError, RecursionError),
)
MAX_DEPTH = 50
"""Lists and mappings may lie in each other this deep; none that is read here needs more than five."""
_PRINTABLE = 1e6
"""Integers beyond this are not spelt out."""


NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
"""Numbers in decimal digits, as text."""
_NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_MERGE = "tag:yaml.org,2002:merge"
_WHOLE = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_REAL = re.compile(rf"{NUMBER.pattern}|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


# libyaml's loader is several times faster; PyYAML is also built without it.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Loader(_SafeLoader):  # type: ignore[misc]
    """SafeLoader that refuses a key given twice, where YAML libraries silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                text = f"key {key.value!r} is given twice"
                raise yaml.constructor.ConstructorError(None, None, text, key.start_mark)
            seen.add(key.value)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Refuse merges, in place of following them."""
        for key, _ in node.value:
            if key.tag == _MERGE:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    "<< merges mappings, which is not taken: write out what they hold",
                    key.start_mark,
                )


def _whole(loader: Any, node: yaml.ScalarNode) -> int:  # noqa: ANN401 (whichever loader there is)
    text = _digits(loader, node, _WHOLE)
    return int(text, {"0o": 8, "0x": 16}.get(text.lstrip("+-")[:2], 10))


def _real(loader: Any, node: yaml.ScalarNode) -> float:  # noqa: ANN401 (likewise)
    return float(re.sub(r"\.(?=[a-z])", "", _digits(loader, node, _REAL).lower()))


def _digits(loader: Any, node: yaml.ScalarNode, form: re.Pattern[str]) -> str:  # noqa: ANN401 (likewise)
    """What is written there, if it has that form: a tag such as !!float can stand before any text."""
    text = str(loader.construct_scalar(node))
    if not form.fullmatch(text):
        raise ValueError(f"{shown(text)} is no number")
    return text


class _Dumper(_SafeDumper):  # type: ignore[misc]
    """SafeDumper that puts texts in quotes which are numbers to `_Loader`."""


for _kind in (_Loader, _Dumper):
    _kind.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in _NUMBER_TAGS]
        for first, resolvers in _kind.yaml_implicit_resolvers.items()
    }
    for _tag, _pattern in zip(_NUMBER_TAGS, (_WHOLE, _REAL), strict=True):
        _kind.add_implicit_resolver(_tag, re.compile(rf"(?:{_pattern.pattern})\Z"), list("-+.0123456789"))
_Loader.add_constructor(_NUMBER_TAGS[0], _whole)
_Loader.add_constructor(_NUMBER_TAGS[1], _real)


def parse_yaml(text: str) -> object:
    """The plain value that YAML text stands for.

    Raises:
        ValueError: it is not YAML, merges, is nested too deep or gives a key twice; one line says why.
    """
    try:
        _check_depth(text)
        # _Loader is a SafeLoader: it makes plain values only.
        return yaml.load(text, Loader=_Loader)
    except YAML_ERRORS as error:
        said = str(error).replace(' in "<unicode string>", line', " at line")
        reason = " ".join(said.split()) or type(error).__name__
        raise ValueError(f"not YAML that can be read ({reason[:300]})") from error


def dump_yaml(value: object, *, width: int | None = None) -> str:
    """YAML text that `parse_yaml` reads as the same plain value; innermost lists are on one line.

    Lines longer than `width`, 80 characters if None, are broken where that changes nothing.
    """
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=width))


def read_text(path: Path, longest: int) -> str:
    """The text of a YAML file of at most `longest` bytes; reading more of it would take minutes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is longer, or not UTF-8.
    """
    with path.open("rb") as file:
        content = file.read(longest + 1)
    if len(content) > longest:
        raise ValueError(f"longer than {longest} bytes")
    return content.decode()


def _check_depth(text: str) -> None:
    """Refuse deep nesting before a value is made of it.

    libyaml makes values by recursion in C, which no Python error stops: the process would end. Its parser,
    which only tells where what begins and ends, does not recurse. It reads ahead, and from version 0.2.6 on
    it refuses a thousand brackets in each other by itself, before it has told of the first.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError(f"lists and mappings lie in each other more than {MAX_DEPTH} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def shown(value: object) -> str:
    """A value in a few words: a list may hold itself, an integer may be too long to print."""
    match value:
        case None:
            return "nothing"
        case Mapping():
            return "a mapping"
        case list() | tuple():
            return f"a list of {len(value)}"
        case int() if abs(value) > _PRINTABLE:
            return f"one beyond {_PRINTABLE:g}"
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
