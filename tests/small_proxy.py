"""A small reverse proxy on a port of its own: under a path or not, which it strips or not."""

import http.client
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

ON_THEIR_WAY = 30.0
"""How long the server behind may take on a busy machine, s."""
ONE_CONNECTION = {"connection", "keep-alive", "transfer-encoding", "te", "upgrade"}


@contextmanager
def small_proxy(upstream, prefix="", strips=True, **headers):
    """Its address, HOST:PORT, before `upstream`, which is HOST:PORT, too.

    What lies under `prefix` is asked of the server behind, without the prefix if it `strips`; `headers`
    (X_Forwarded_Proto="https") take the place of what the client sends. Host is passed on as it is.
    """
    said = {name.replace("_", "-"): value for name, value in headers.items()}

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def _pass_on(self):
            if not f"{self.path.partition('?')[0]}/".startswith(f"{prefix}/"):
                self.send_error(404)
                return
            path = self.path.removeprefix(prefix) if strips else self.path
            sent = {name: value for name, value in self.headers.items() if name.lower() not in ONE_CONNECTION}
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            behind = http.client.HTTPConnection(upstream, timeout=ON_THEIR_WAY)
            try:
                behind.request(self.command, path or "/", body or None, sent | said)
                answer = behind.getresponse()
                content = answer.read()
                self.send_response_only(answer.status)
                for name, value in answer.getheaders():
                    if name.lower() not in ONE_CONNECTION:
                        self.send_header(name, value)
                self.end_headers()
                self.wfile.write(content)
            finally:
                behind.close()

        do_GET = do_HEAD = do_POST = do_DELETE = do_OPTIONS = _pass_on

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()
