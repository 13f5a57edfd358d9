"""HTTP requests as metrics know them: by a few names, whatever is asked for."""

import asyncio

import httpx
import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Mount, Route

from ogm_services.mapper.serving.measured_http import MeasuredHttp


class Noted:
    def __init__(self):
        self.answered = []

    def http_answered(self, route, method, status, seconds):
        assert 0.0 <= seconds < 60.0
        self.answered.append((route, method, status))


async def fine(request):
    return PlainTextResponse("ok")


async def broken(request):
    raise ZeroDivisionError


def ask(*requests):
    """What is noted of these requests, each a method and a target."""
    routes = [
        Route("/map.png", fine),
        Route("/tiles/{z}/{x}", fine),
        Route("/broken", broken),
        Mount("/static", routes=[Route("/a.js", fine)]),
    ]
    app, noted = Starlette(routes=routes), Noted()
    measured = MeasuredHttp(app, noted, app.routes)

    async def send():
        transport = httpx.ASGITransport(measured, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://mapper") as client:
            for method, target in requests:
                await client.request(method, target)

    asyncio.run(send())
    return noted.answered


@pytest.mark.parametrize(
    ("method", "target", "wanted"),
    [
        ("GET", "/map.png?region=1,2,3,4", ("/map.png", "GET", "2xx")),
        ("HEAD", "/map.png", ("/map.png", "HEAD", "2xx")),
        ("PUT", "/map.png", ("/map.png", "PUT", "4xx")),
        ("GET", "/tiles/7/9?x=1", ("/tiles/{z}/{x}", "GET", "2xx")),
        ("GET", "/nowhere", ("other", "GET", "4xx")),
        ("GET", "/map.png/", ("other", "GET", "3xx")),
        ("GET", "/static/a.js", ("/static", "GET", "2xx")),
        ("BREW", "/map.png", ("/map.png", "other", "4xx")),
        ("GET", "/broken", ("/broken", "GET", "5xx")),
    ],
)
def test_a_request_is_noted_by_template_method_and_class_of_status(method, target, wanted):
    assert ask((method, target), (method, target)) == [wanted, wanted]


def test_a_flood_of_paths_and_methods_has_a_few_names():
    requests = [(f"M{number}", f"/{number}?q={number}") for number in range(50)]
    requests += [("GET", f"/tiles/{number}/{number}") for number in range(50)]
    assert set(ask(*requests)) == {("other", "other", "4xx"), ("/tiles/{z}/{x}", "GET", "2xx")}
