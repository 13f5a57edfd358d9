"""docker/nginx.conf before a mapper: TLS outside, map and page inside, and the mapper's own rules hold.

The file is the one that people copy; ports and the certificate's files are put in.
"""

import shutil
import ssl
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from ogm_services.mapper.serving.http_server import bound_socket

CONF = Path(__file__).parents[2] / "docker" / "nginx.conf"
NAME, TOKEN = "map.example.org", "correct-horse-battery-staple"
STARTED = 30.0
AROUND = """
daemon off;
pid {folder}/pid;
events {{ worker_connections 64; }}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    include {folder}/mapper.conf;
}}
"""


def program(name):
    """A program of Debian's; tests that want it are skipped where it is not."""
    found = shutil.which(name, path="/usr/sbin:/usr/bin:/sbin:/bin:/usr/local/bin")
    if found is None:
        pytest.skip(f"{name} is not installed: apt-get install nginx-light openssl")
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that nginx's workers, who are another user where root starts them, may enter."""
    folder = tmp_path_factory.mktemp("nginx")
    for parent in (folder, folder.parent):
        parent.chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def certificate(folder):
    """A certificate of NAME that signs itself, and its key."""
    made, key = folder / "map.pem", folder / "map.key"
    subject = ["-subj", f"/CN={NAME}", "-addext", f"subjectAltName=DNS:{NAME}"]
    new_key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    command = [program("openssl"), "req", "-x509", *new_key, *subject, "-keyout", key, "-out", made]
    subprocess.run(command, check=True, capture_output=True)
    return made, key


@pytest.fixture(scope="module")
def mapper(start_mapper):
    """A mapper that knows the proxy's name, and wants a token for writes."""
    http = {"port": 0, "hosts": [NAME], "forwarded_allow_ips": ["127.0.0.1"], "token": TOKEN}
    with start_mapper(map={"resolution": 0.5}, http=http) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture(scope="module")
def proxy(folder, certificate, mapper):
    """A client of nginx, as NAME; its base URL has NAME's address."""
    nginx = program("nginx")
    with bound_socket("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    text = CONF.read_text()
    for old, new in (
        ("listen 443 ssl;", f"listen 127.0.0.1:{port} ssl;"),
        ("http://127.0.0.1:8000;", f"http://127.0.0.1:{mapper.http.base_url.port};"),
        ("/etc/ssl/certs/map.pem", str(certificate[0])),
        ("/etc/ssl/private/map.key", str(certificate[1])),
    ):
        assert old in text, old
        text = text.replace(old, new)
    (folder / "mapper.conf").write_text(text)
    (folder / "nginx.conf").write_text(AROUND.format(folder=folder))
    own_address = {"Host": f"{NAME}:{port}"}
    with (
        nginx_running(nginx, folder),
        httpx.Client(
            transport=_As(NAME, verify=ssl.create_default_context(cafile=certificate[0])),
            base_url=f"https://127.0.0.1:{port}",
            timeout=STARTED,
            headers=own_address,
        ) as client,
    ):
        yield client


@contextmanager
def nginx_running(nginx, folder):
    """nginx with the configuration in a folder, once it listens."""
    command = [nginx, "-p", folder, "-c", folder / "nginx.conf", "-e", folder / "error.log"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            deadline = time.monotonic() + STARTED
            while not (folder / "pid").exists():
                assert process.poll() is None, process.stderr.read()
                assert time.monotonic() < deadline
                time.sleep(0.01)
            yield
        finally:
            process.terminate()


class _As(httpx.HTTPTransport):
    """Asks for a certificate of this name, wherever the server is."""

    def __init__(self, name, **options):
        super().__init__(**options)
        self._name = name

    def handle_request(self, request):
        request.extensions["sni_hostname"] = self._name
        return super().handle_request(request)


def test_the_map_and_the_page_come_through_tls(proxy, mapper):
    assert proxy.get("/map.png").raise_for_status().content == mapper.http.get("/map.png").content
    assert proxy.get("/").raise_for_status().text == mapper.http.get("/").text
    assert proxy.get("/status").json()["revision"] == 3
    etag = proxy.get("/map.json").headers["ETag"]
    assert proxy.get("/map.json", headers={"If-None-Match": etag}).status_code == 304


def test_tiles_are_described_by_the_address_that_was_asked_for(proxy):
    for stranger in ({}, {"X-Forwarded-Prefix": "/evil", "X-Forwarded-Host": "localhost"}):
        (tiles,) = proxy.get("/tiles.json", headers=stranger).json()["tiles"]
        assert tiles == f"https://{proxy.headers['Host']}/tiles/{{z}}/{{x}}/{{y}}.png"


def test_the_certificate_is_the_one_that_was_made(proxy):
    address = str(proxy.base_url)
    with httpx.Client() as strict, pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        strict.get(address)


def test_the_mapper_knows_the_proxy_by_its_name_and_no_other(proxy):
    assert proxy.get("/status").status_code == 200
    refused = proxy.get("/status", headers={"Host": "evil.example"})
    assert (refused.status_code, refused.headers["content-type"]) == (421, "application/problem+json")


def test_the_token_is_passed_on(proxy):
    epoch = proxy.get("/status").json()["epoch"]
    wrong = {"Authorization": f"Bearer {TOKEN}x"}
    assert [proxy.post("/reset").status_code, proxy.post("/reset", headers=wrong).status_code] == [401, 401]
    assert proxy.get("/status").json()["epoch"] == epoch
    right = {"Authorization": f"Bearer {TOKEN}"}
    assert proxy.post("/reset", headers=right).status_code == 200
    assert proxy.get("/status").json()["epoch"] != epoch


def test_pages_of_other_origins_are_kept_out_and_the_own_one_is_not(proxy):
    right = {"Authorization": f"Bearer {TOKEN}"}
    own = {"Origin": f"https://{proxy.headers['Host']}"}
    assert proxy.post("/reset", headers=right | {"Origin": "https://evil.example"}).status_code == 403
    assert proxy.post("/reset", headers=right | own).status_code == 200


def test_nginx_slows_down_whoever_asks_too_often(proxy):
    assert 429 in [proxy.get("/livez").status_code for _ in range(200)]
