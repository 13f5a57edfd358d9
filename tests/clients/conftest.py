"""A fake mapper that answers over Zenoh or HTTP, and notes what it was asked."""

import json
import threading
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import get_args
from urllib.parse import parse_qsl, unquote, urlsplit

import msgpack
import numpy as np
import pytest

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.files.map_files import encode_npz
from ogm_core.lattice import Lattice
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import encode_status
from ogm_core.wire.keys import Service, Write
from ogm_core.wire.map_update import MapUpdate, encode_update
from status_json import STATUS

MAP_NAME = "hall"
WRITES = get_args(Write)
PROBLEM = "application/problem+json"


@dataclass
class FakeMapper:
    """Answers to all requests, whatever carries them; `asked` notes (name, parameters), HTTP's headers aside.

    `address` and `over` ("zenoh", "http") say how it is reached. `bodies` overrides answers, `meta` what
    accompanies a map (... takes it away); a `problem` refuses all. `later` swaps the map just before the
    request of that number (from 0) is answered. `name`: of the map, in the status. `garbled`: the HTTP status
    of a `problem` that is none.
    """

    address: str
    over: str
    snapshot: MapSnapshot
    bodies: dict = field(default_factory=dict)
    problem: dict | bytes | None = None
    meta: dict = field(default_factory=dict)
    later: dict = field(default_factory=dict)
    name: str = MAP_NAME
    garbled: int = 500
    asked: list = field(default_factory=list)

    def take(self, name, parameters):
        """Note a request; return its body, or None if it is refused."""
        self.snapshot = self.later.pop(len(self.asked), self.snapshot)
        self.asked.append((name, parameters))
        if self.problem is not None:
            return None
        if name in self.bodies:
            return self.bodies[name]
        if name == "status":
            told = {name: getattr(self.snapshot, name) for name in ("epoch", "run", "revision")}
            return encode_status(replace(STATUS, **told, map=self.name))
        if name == "map.tiles":
            return encode_tiles(self.snapshot, parameters.get("since"))
        return encode_npz(self.snapshot) if name == "map.npz" else f"{name} as asked".encode()

    def map_meta(self):
        """What accompanies a map over Zenoh."""
        meta = {**self.snapshot.meta(), **self.meta}
        return {name: value for name, value in meta.items() if value is not ...}

    def refusal(self):
        """The body of an error reply."""
        return self.problem if isinstance(self.problem, bytes) else json.dumps(self.problem).encode()


def encode_tiles(snapshot, since):
    """map.tiles of a snapshot: all of it, but for who has it."""
    known = since == f"{snapshot.epoch}-{snapshot.run}-{snapshot.revision}"
    rect, tiles = snapshot.rect, []
    for ty in range(rect.iy // 64, (rect.iy + rect.height - 1) // 64 + 1):
        tiles += [(tx, ty) for tx in range(rect.ix // 64, (rect.ix + rect.width - 1) // 64 + 1)]
    cells = np.zeros((len(tiles), 64, 64), snapshot.cells.dtype)
    for (iy, ix), value in np.ndenumerate(snapshot.cells):
        (tx, x), (ty, y) = divmod(ix + rect.ix, 64), divmod(iy + rect.iy, 64)
        cells[tiles.index((tx, ty)), y, x] = value
    model = snapshot.model
    update = MapUpdate(
        epoch=snapshot.epoch,
        run=snapshot.run,
        prev=snapshot.revision if known else 0,
        revision=snapshot.revision,
        stamp=snapshot.stamp,
        lattice=snapshot.lattice,
        planes=model.planes,
        model=model.described,
        extent=rect,
        tiles=np.array([] if known else tiles, np.int64).reshape(-1, 2),
        cells={PLANE: cells[: 0 if known else None].reshape(-1, 64 * 64)},
        whole=not known,
    )
    return encode_update(update)


def on_query(mapper, query):
    """Answer over Zenoh."""
    service = str(query.key_expr).rpartition("/")[2]
    parameters = dict(part.split("=") for part in str(query.parameters).split(";") if part)
    name = f"map.{parameters.pop('format', 'json')}" if service == "map" else service
    body = mapper.take(name, parameters)
    if body is None:
        query.reply_err(mapper.refusal(), encoding=PROBLEM)
    else:
        attachment = msgpack.packb(mapper.map_meta()) if service == "map" else None
        query.reply(query.key_expr, body, attachment=attachment)


class Handler(BaseHTTPRequestHandler):
    """Answer over HTTP; the server carries the mapper."""

    def do_GET(self):
        url = urlsplit(self.path)
        mapper, name = self.server.mapper, url.path.removeprefix("/")
        given = dict(parse_qsl(url.query))
        if self.command == "DELETE":
            folder, _, named = name.partition("/")
            name, parameter = {"snapshots": ("delete", "name"), "robots": ("forget", "robot")}[folder]
            given[parameter] = unquote(named)
        elif (name in WRITES) != (self.command == "POST"):
            return self.send_error(405)
        body = mapper.take(name, given)
        snap = mapper.snapshot
        etag = f'"{snap.epoch}-{snap.run}-{snap.revision}"'
        headers = {
            "OGM-Epoch": snap.epoch,
            "OGM-Run": snap.run,
            "OGM-Revision": snap.revision,
            "OGM-Stamp": json.dumps(snap.stamp),
        }
        for key, value in mapper.meta.items():
            headers[f"OGM-{key.capitalize()}"] = value
        if body is None:
            headers = {"Content-Type": PROBLEM if isinstance(mapper.problem, dict) else "text/plain"}
            status = mapper.problem["status"] if isinstance(mapper.problem, dict) else mapper.garbled
            body = mapper.refusal()
        elif self.headers["If-None-Match"] == etag:
            mapper.asked[-1] = (name, "not modified")
            status, body = 304, b""
        else:
            status = 200
        self.send_response(status)
        for key, value in headers.items():
            if value is not ...:
                self.send_header(key, str(value))
        self.send_header("ETag", etag)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        return None

    do_POST = do_DELETE = do_GET

    def log_message(self, *args):
        """Stay silent."""


@pytest.fixture
def snapshot():
    """Rows from the south: unknown, occupied; free, back at the prior; free, undecided (p = 0.62)."""
    cells = np.array([[0, 20001], [-20001, 1], [-6001, 2001]], np.int16)
    lattice = Lattice(0.1, (0.5, -0.25))
    return MapSnapshot(
        CellArrays.of(LogOdds(), cells),
        LogOdds(),
        lattice,
        (-5, 10),
        epoch="first",
        run="one",
        revision=7,
        stamp=1_700_000_000_000_000_001,
    )


@pytest.fixture
def zenoh_mapper(listener, endpoint, snapshot):
    """A fake mapper of the map MAP_NAME, reached over Zenoh."""
    mapper = FakeMapper(endpoint, "zenoh", snapshot)
    for service in get_args(Service):
        listener.declare_queryable(f"ogm/v1/{MAP_NAME}/{service}", lambda query: on_query(mapper, query))
    return mapper


@pytest.fixture
def http_mapper(snapshot):
    """A fake mapper reached over HTTP."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        mapper = FakeMapper(f"http://127.0.0.1:{server.server_port}", "http", snapshot)
        server.mapper, server.daemon_threads = mapper, True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield mapper
        server.shutdown()
        thread.join()


@pytest.fixture(params=["zenoh", "http"])
def mapper(request):
    """The same fake mapper, reached over Zenoh and over HTTP in turn."""
    return request.getfixturevalue(f"{request.param}_mapper")


@pytest.fixture
def client(mapper):
    """A client of `mapper`; over HTTP one that takes any map, and asks for nothing besides."""
    from ogm_client import MapClient

    name = MAP_NAME if mapper.over == "zenoh" else None
    with MapClient(mapper.address, map_name=name, timeout=30.0) as client:
        yield client
