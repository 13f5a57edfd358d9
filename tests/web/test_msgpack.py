"""The page's MessagePack reads what Python's writes, and writes what Python's reads."""

import base64
import random
import string

import msgpack
import pytest

from page_desk import module

ECHO = """async (messages) => {
  const {unpack} = await MODULE;
  const plain = (value) => {
    if (value instanceof Uint8Array) return {bin: [...value]};
    if (typeof value === "bigint") return {big: value.toString()};
    if (typeof value === "number" && !Number.isFinite(value)) return {odd: String(value)};
    if (Array.isArray(value)) return {list: value.map(plain)};
    if (value === null || typeof value !== "object") return value;
    return {map: Object.entries(value).map(([key, one]) => [key, plain(one)])};
  };
  return messages.map((text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    try { return [plain(unpack(bytes.buffer)), null]; } catch (error) { return [null, error.name]; }
  });
}""".replace("MODULE", module("msgpack"))
SAID = {"type": "view", "z": 16, "tiles": [-3, -70000, 5, 2**40], "palette": "ros ä"}
SAID |= {"rate": 0.5, "scans": True, "none": None}


def plain(value):
    """A value as ECHO says it."""
    if isinstance(value, bytes):
        return {"bin": list(value)}
    if isinstance(value, int) and not isinstance(value, bool) and not -(2**53) <= value < 2**53:
        return {"big": str(value)}
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return {"odd": "Infinity" if value > 0 else "-Infinity"}
    if isinstance(value, list):
        return {"list": [plain(one) for one in value]}
    if isinstance(value, dict):
        return {"map": [[key, plain(one)] for key, one in value.items()]}
    return value


def made_up(rng, depth=0):
    """A random value."""
    kinds = ["none", "bool", "int", "float", "text", "bytes", *(["list", "map"] if depth < 3 else [])]
    kind = rng.choice(kinds)
    length = rng.choice([0, 1, 5, 15, 16, 31, 32, 40, 255, 256, 300] if depth == 0 else [0, 1, 3])
    if kind == "int":
        return rng.choice([-1, 1]) * rng.getrandbits(
            rng.choice([0, 1, 5, 7, 8, 15, 16, 31, 32, 52, 53, 62, 63])
        )
    if kind == "float":
        return rng.choice([rng.uniform(-1e9, 1e9) + 0.5, 1e300, -5e-324, float("inf")])
    if kind == "text":
        return "".join(rng.choice(string.ascii_letters + "äß€😀") for _ in range(length))
    if kind == "bytes":
        return rng.randbytes(length)
    if kind == "list":
        return [made_up(rng, depth + 1) for _ in range(length)]
    if kind == "map":
        return {f"k{k}": made_up(rng, depth + 1) for k in range(length)}
    return {"none": None, "bool": rng.random() < 0.5}[kind]


@pytest.fixture(scope="module")
def page(lab, chromium):
    context = chromium.new_context()
    made = context.new_page()
    made.goto(lab.url)
    yield made
    context.close()


def test_random_values_are_read_as_they_were_written(page):
    rng = random.Random(1)
    values = [made_up(rng) for _ in range(300)] + [
        2**64 - 1,
        -(2**63),
        [None] * 70_000,
        "x" * 70_000,
        {"__proto__": 1},
    ]
    said = [base64.b64encode(msgpack.packb(value)).decode() for value in values]
    for value, (heard, error) in zip(values, page.evaluate(ECHO, said), strict=True):
        assert (heard, error) == (plain(value), None)


def test_what_is_no_message_is_refused(page):
    whole = msgpack.packb({"a": [1, "text", b"bytes", 1.5]})
    broken = [whole[:cut] for cut in range(len(whole))] + [
        whole + b"\x00",
        b"\xc1",
        msgpack.packb({1: 2}),
        b"\xa1\xff",
    ]
    broken.append(msgpack.packb(msgpack.ExtType(1, b"x")))
    said = [base64.b64encode(message).decode() for message in broken]
    for heard, error in page.evaluate(ECHO, said):
        assert heard is None
        assert error in ("RangeError", "TypeError")


def test_what_the_page_says_is_read(page):
    script = f"async (said) => [...(await {module('msgpack')}).pack(said)]"
    assert msgpack.unpackb(bytes(page.evaluate(script, SAID))) == SAID
