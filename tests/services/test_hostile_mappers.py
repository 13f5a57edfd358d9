"""`ogm get` and `ogm status` of what is no mapper: exit code 1, and one line that says why."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from typer.testing import CliRunner

from ogm_services.cli import app

PROBLEM = b'{"type": "\\u001b[2J", "status": 503, "detail": "no\\n\\u001b]0;x\\u0007"}'


class Handler(BaseHTTPRequestHandler):
    """Answers everything with the server's body."""

    def do_GET(self):
        self.send_response(self.server.code)
        self.send_header("Content-Type", "application/problem+json")
        for name in ("OGM-Epoch", "OGM-Revision", "OGM-Stamp"):
            self.send_header(name, "1")
        self.send_header("Content-Length", str(len(self.server.body)))
        self.end_headers()
        self.wfile.write(self.server.body)

    def log_message(self, *args):
        """Stay silent."""


@pytest.fixture
def server():
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("code", "body", "says"),
    [
        (200, b"[" * 100_000, "nested too deep"),
        (200, b'{"uptime_s": NaN}', "NaN is no number of JSON's"),
        (200, b'{"map": ' + b"1" * 5000 + b"}", "not JSON"),
        (200, b"\xff\x00", "not JSON"),
        (503, PROBLEM, "the mapper refused: no ?]0;x? (?[2J, 503)"),
        (503, b"[" * 60_000, "nested too deep"),
    ],
)
@pytest.mark.parametrize("command", [("status",), ("status", "--json"), ("get", "map.yaml", "-o", "m.yaml")])
def test_what_is_no_mapper_s_answer_is_told_in_one_line(
    server, tmp_path, monkeypatch, command, code, body, says
):
    monkeypatch.chdir(tmp_path)
    server.code, server.body = code, body
    url = f"http://127.0.0.1:{server.server_port}"
    result = CliRunner().invoke(app, [*command, "--url", url], prog_name="ogm", catch_exceptions=False)
    assert result.exit_code == 1
    assert result.stderr.startswith("ogm: ")
    [line] = result.stderr.splitlines()
    assert line.isprintable()
    assert len(line) < 500
    assert (says in line) or (command[0] == "get" and code == 200)
    assert not list(tmp_path.iterdir())
