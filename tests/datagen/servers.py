"""Places for datasets besides folders: memory, a real HTTP server and a real S3 server, all on this machine."""

import contextlib
import functools
import http.client
import http.server
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import fsspec
import pytest


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder, and remembers what was asked for."""

    asked: list[str] = []  # noqa: RUF012  (a fresh subclass a server)

    def do_GET(self) -> None:
        self.asked.append(self.path)
        super().do_GET()

    def log_message(self, *args: Any) -> None:
        pass


@contextlib.contextmanager
def http_server(folder: Path) -> Iterator[tuple[str, list[str]]]:
    kind = type("Handler", (Handler,), {"asked": []})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(kind, directory=str(folder)))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", kind.asked  # type: ignore[attr-defined]
    finally:
        server.shutdown()
        server.server_close()


@contextlib.contextmanager
def in_memory(folder: Path, name: str = "sets") -> Iterator[str]:
    memory = fsspec.filesystem("memory")
    for path in folder.rglob("*"):
        if path.is_file():
            memory.pipe_file(f"/{name}/one/{path.relative_to(folder)}", path.read_bytes())
    try:
        yield f"memory://{name}/one"
    finally:
        memory.rm(f"/{name}", recursive=True)


Fault = Literal["500", "503", "expired", "gone", "no answer", "lost answer", "late", "cut"]
"""What goes wrong with a request: errors that S3 gives, the connection's end before or after it was done, an answer
that comes too late, half of the content."""
ERRORS = {
    "500": (500, "InternalError"),
    "503": (503, "SlowDown"),
    "expired": (400, "ExpiredToken"),
    "gone": (404, "NoSuchUpload"),
}


class Forwarder(http.server.BaseHTTPRequestHandler):
    """Hands requests on to an S3 server, but for what goes wrong; remembers them."""

    protocol_version = "HTTP/1.1"
    behind: tuple[str, int]
    fault: Callable[[str, str], Fault | None]
    asked: list[tuple[str, str]]

    def handle_one_request(self) -> None:
        with contextlib.suppress(OSError):
            super().handle_one_request()

    def do_GET(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.asked.append((self.command, self.path))
        fault = type(self).fault(self.command, self.path)
        if fault in ERRORS:
            status, code = ERRORS[fault]
            self._answer(
                status, {}, f"<Error><Code>{code}</Code><Message>{code}, said the proxy</Message></Error>".encode()
            )
            return
        if fault == "late":
            time.sleep(3)
        if fault in ("no answer", "late"):
            self.close_connection = True
            return
        if fault == "cut":
            body = body[: len(body) // 2]
        server = http.client.HTTPConnection(*self.behind)
        headers = {
            name: value for name, value in self.headers.items() if name.lower() not in ("content-length", "expect")
        }
        server.request(self.command, self.path, body, headers | {"Content-Length": str(len(body))})
        answer = server.getresponse()
        content = answer.read()
        server.close()
        if fault == "lost answer":
            self.close_connection = True
            return
        self._answer(answer.status, dict(answer.getheaders()), content)

    do_PUT = do_POST = do_DELETE = do_HEAD = do_GET  # noqa: N815  (the library's names)

    def _answer(self, status: int, headers: dict[str, str], content: bytes) -> None:
        self.send_response(status)
        for name, value in headers.items():
            if name.lower() not in ("content-length", "connection", "transfer-encoding", "date", "server"):
                self.send_header(name, value)
        length = headers.get("Content-Length") or headers.get("content-length") or str(len(content))
        self.send_header("Content-Length", length if self.command == "HEAD" else str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *args: Any) -> None:
        pass


class FaultyBucket:
    """A real S3 server behind a proxy; `fault` says what goes wrong with a request of a method and path."""

    def __init__(self, server: tuple[str, int]) -> None:
        self.fault: Callable[[str, str], Fault | None] = lambda method, path: None
        self.asked: list[tuple[str, str]] = []
        about = {"behind": server, "asked": self.asked, "fault": staticmethod(lambda *asked: self.fault(*asked))}
        self.proxy = http.server.ThreadingHTTPServer(("127.0.0.1", 0), type("Forwarder", (Forwarder,), about))
        self.proxy.daemon_threads = True
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.proxy.server_port}",
            "AWS_ACCESS_KEY_ID": "AKIA-the-key",
            "AWS_SECRET_ACCESS_KEY": "the-secret",
            "AWS_SESSION_TOKEN": "the-token",
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_MAX_ATTEMPTS": "1",  # the library's own tries would hide what goes wrong
            "FSSPEC_S3": json.dumps({"config_kwargs": {"read_timeout": 1}}),
        }
        self._direct = fsspec.filesystem("s3", key="k", secret="s", endpoint_url=f"http://{server[0]}:{server[1]}")
        if not self._direct.exists("bucket"):
            self._direct.mkdir("bucket")

    def clear(self) -> None:
        """Empty the bucket, and have nothing go wrong."""
        self.fault = lambda method, path: None
        self.asked.clear()
        for path in self._direct.find("bucket", refresh=True):
            self._direct.rm_file(path)

    def contents(self, name: str) -> dict[str, bytes]:
        """Return all files under a name of the bucket, past the proxy."""
        self._direct.invalidate_cache()
        found = self._direct.find(f"bucket/{name}")
        return {path.removeprefix(f"bucket/{name}/"): self._direct.cat_file(path) for path in found}

    def write(self, name: str, content: bytes) -> None:
        """Write a file past the proxy."""
        self._direct.pipe_file(f"bucket/{name}", content)

    def remove(self, name: str) -> None:
        """Remove a file past the proxy."""
        self._direct.rm_file(f"bucket/{name}")


@contextlib.contextmanager
def faulty_bucket() -> Iterator[FaultyBucket]:
    moto = pytest.importorskip("moto.server")
    pytest.importorskip("s3fs")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    bucket = FaultyBucket(server.get_host_and_port())
    threading.Thread(target=bucket.proxy.serve_forever, daemon=True).start()
    try:
        yield bucket
    finally:
        bucket.proxy.shutdown()
        bucket.proxy.server_close()
        server.stop()


@contextlib.contextmanager
def s3_server(folder: Path) -> Iterator[str]:
    moto = pytest.importorskip("moto.server")
    pytest.importorskip("s3fs")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    options = {"key": "key", "secret": "secret", "endpoint_url": f"http://{host}:{port}"}
    fsspec.config.conf["s3"] = options
    try:
        bucket = fsspec.filesystem("s3")
        if not bucket.exists("bucket"):
            bucket.mkdir("bucket")
        for path in folder.rglob("*"):
            if path.is_file():
                bucket.pipe_file(f"bucket/sets/one/{path.relative_to(folder)}", path.read_bytes())
        yield "s3://bucket/sets/one"
    finally:
        bucket.rm("bucket/sets", recursive=True)
        del fsspec.config.conf["s3"]
        server.stop()
