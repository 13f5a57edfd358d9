"""While a stored map is restored nobody is served: what there is of it is no map yet."""

import socket
import threading
from contextlib import closing

import httpx
import pytest

from ogm_services.mapper.service import MapperService
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.settings.settings import Settings


def free_port():
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        return taken.getsockname()[1]


def test_connections_are_refused_until_the_map_is_restored(
    tmp_path, monkeypatch, in_background, eventually, start_mapper
):
    with start_mapper(mapper={"data": str(tmp_path)}) as mapper:
        mapper.draw_cross()
        cells = mapper.http.get("/map.npz").content
        assert mapper.status()["restored"] is False
    begun, go_on, restore = threading.Event(), threading.Event(), MapStore.restore

    def slowly(*args):
        begun.set()
        assert go_on.wait(60.0)
        return restore(*args)

    monkeypatch.setattr(MapStore, "restore", slowly)
    http, zenoh = free_port(), free_port()
    sections = {"network": {"map_name": "hall", "listen": [f"tcp/127.0.0.1:{zenoh}"]}, "http": {"port": http}}
    settings = Settings.model_validate({**sections, "mapper": {"data": str(tmp_path)}})
    starting = in_background(MapperService, settings)
    try:
        assert begun.wait(60.0)
        for port in (http, zenoh):
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", port))
    finally:
        go_on.set()
    with starting.result(60.0):
        url = f"http://127.0.0.1:{http}"
        eventually(lambda: httpx.get(f"{url}/readyz").status_code == 200)
        assert httpx.get(f"{url}/map.npz").content == cells
        assert httpx.get(f"{url}/status").json()["restored"] is True
