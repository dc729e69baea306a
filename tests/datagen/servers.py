"""Places for datasets besides folders: memory, a real HTTP server and a real S3 server, all on this machine."""

import contextlib
import functools
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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
