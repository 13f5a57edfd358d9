"""The examples of map updates for other languages: what this version makes, and what a copy makes of them."""

import base64
import hashlib
import json
import struct
import zlib

import msgpack
import numpy as np

from ogm_client.map_copy import MapCopy, Taken
from ogm_core.wire.map_update import decode_updates
from update_vectors import FILE, made, sha256

STEPS = json.loads(FILE.read_text())["steps"]
DONE = {"apply": Taken.APPLIED, "ignore": Taken.KNOWN, "wait": Taken.PART, "ask": Taken.GAP}


def update_of(step):
    (update,) = decode_updates(base64.b64decode(step["message"]))
    return update


def test_a_copy_does_with_each_what_is_said_and_is_then_what_is_said():
    copy, answers = MapCopy(2**30), False
    for step in STEPS:
        assert copy.take(update_of(step), asked=answers) is DONE[step["do"]], step["what"]
        answers = step["do"] == "ask"
        assert_is(copy, step["copy"])


def assert_is(copy, said):
    if said is None:
        assert copy.version is None
        return
    assert list(copy.version) == [said["epoch"], said["run"], said["revision"]]
    assert list(copy.newest.extent) == said["extent_cells"]
    tiles = {
        place: {name: sha256(plane) for name, plane in planes.items()} for place, planes in copy.tiles.items()
    }
    assert tiles == {(tx, ty): planes for tx, ty, planes in said["tiles"]}
    grid = copy.grid()
    for ix, iy, value in said["log_odds"]:
        x, y = ((index + 0.5) * grid.resolution for index in (ix, iy))
        column, row = ix - grid.offset[0], iy - grid.offset[1]
        inside = 0 <= column < grid.width and 0 <= row < grid.height
        found = grid.log_odds[row, column] if inside else np.nan
        expected = np.nan if value is None else grid.log_odds.dtype.type(value)
        np.testing.assert_array_equal(found, expected, err_msg=f"{ix, iy}")
        assert grid.world_to_cell(x, y) == (ix, iy)


def test_the_file_says_what_this_version_makes():
    """If not, and if that is meant: python tests/update_vectors.py."""
    steps = list(made())
    assert [(what, do) for what, _, do, _ in steps] == [(step["what"], step["do"]) for step in STEPS]
    for (what, update, _, copy), step in zip(steps, STEPS, strict=True):
        assert step["copy"] == copy, what
        there = update_of(step)
        for name in update.__slots__:
            one, other = getattr(update, name), getattr(there, name)
            if name == "cells":
                planes = other if len(there.tiles) else ()
                assert all(np.array_equal(one[plane], other[plane]) for plane in planes), what
            else:
                assert np.array_equal(one, other) if name == "tiles" else one == other, (what, name)


def test_whoever_reads_a_message_as_it_is_documented_gets_the_same():
    step = next(step for step in STEPS if step["do"] == "apply")
    fields = msgpack.unpackb(base64.b64decode(step["message"]))
    places = np.frombuffer(fields["tiles"], "<i8").reshape(-1, 2)
    data = zlib.decompress(fields["data"])
    assert (fields["whole"], fields["planes"]) == (
        True,
        [{"name": "log_odds", "dtype": "int16", "per_side": 1}],
    )
    tiles = {
        (tx, ty): data[k * 2 * 64 * 64 : (k + 1) * 2 * 64 * 64] for k, (tx, ty) in enumerate(places.tolist())
    }
    assert len(data) == len(tiles) * 2 * 64 * 64
    said = {(tx, ty): planes["log_odds"] for tx, ty, planes in step["copy"]["tiles"]}
    assert {place: hashlib.sha256(cells).hexdigest() for place, cells in tiles.items()} == said
    for ix, iy, value in step["copy"]["log_odds"]:
        tile = tiles.get((ix // 64, iy // 64), bytes(2 * 64 * 64))
        (cell,) = struct.unpack_from("<h", tile, 2 * (iy % 64 * 64 + ix % 64))
        model = fields["model"]
        assert (model["l0"] + (cell >> 1) * model["step"] if cell else None) == value


def test_every_kind_of_message_is_among_them():
    updates = [update_of(step) for step in STEPS]
    assert {step["do"] for step in STEPS} == set(DONE)
    assert {update.planes[0].dtype for update in updates} == {np.dtype(np.int16), np.dtype(np.float64)}
    assert min(update.extent.ix for update in updates) < -64
    assert any(value is not None for step in STEPS for *_, value in (step["copy"] or {}).get("log_odds", ()))
