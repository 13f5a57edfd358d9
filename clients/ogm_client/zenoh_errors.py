"""Errors of Zenoh's in plain words: no Rust, no source locations, no values that may be secret."""

import re

import zenoh

from ogm_core.errors import printable
from ogm_core.wire.addresses import masked

_SOURCE = re.compile(r" at /\S+\.rs:\d+\.?")
_MESSAGE = re.compile(r'Message \{ msg: "(?P<what>.*)", location: Some\(Location \{ line: (?P<line>\d+)')
_YAML = re.compile(r'problem: "(?P<what>.*)", problem_mark: Mark \{ line: (?P<line>\d+)')
_SYNTAX = re.compile(r"\s*--> (?P<line>\d+):\d+\n.*\n\s*= (?P<what>.*)", re.DOTALL)
_VALUE = re.compile(r"(?P<kind>invalid (?:type|value): [\w ]+?) [\"`].*[\"`], expected")


def reason(error: zenoh.ZError) -> str:
    """What Zenoh says went wrong, on one line, without the source locations that it appends."""
    return " ".join(_SOURCE.sub("", str(error)).split()).rstrip(".!")


def wrong_in_file(error: zenoh.ZError) -> str:
    """What is wrong with a configuration file, and in which line, without the values that stand in it."""
    text = _SOURCE.sub("", str(error))
    unquoted = re.sub(r"\\(.)", r"\1", text)  # Rust writes texts with escapes
    if found := _MESSAGE.search(unquoted) or _YAML.search(unquoted):
        what = masked(_VALUE.sub(r"\g<kind>, expected", found["what"]))
    elif found := _SYNTAX.match(text):
        what = f"no JSON5, {found['what']}"
    else:
        return reason(error)
    return printable(f"Zenoh does not take line {found['line']}: {what}")
