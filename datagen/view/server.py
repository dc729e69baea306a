"""The light mixer's server: on this machine alone, reading only, answering for one dataset and nothing else."""

import re
import sys
import threading
import webbrowser
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from os import environ
from pathlib import Path

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.store import scene_folder
from multilight.datagen.text import plain
from multilight.datagen.view.content import PREVIEW, ViewFiles, dataset_json, preview, scene_json, view_folder

SITE = Path(__file__).parent / "site"
"""The page, as `make web` builds it of `web/`."""
PAGE = {"index.html": "text/html; charset=utf-8", "app.js": "text/javascript", "app.css": "text/css"}
LOOPBACK = "127.0.0.1"
PORT = 8765
KEPT_RECORDS, KEPT_VIEWS = 64, 3
"""How many scenes' records and decoded views stay in memory."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Answers:
    """What is answered to a path; views that were read last are kept."""

    def __init__(self, source: DatasetSource) -> None:
        """Answer for an opened dataset."""
        self._source = source
        self._lock = threading.Lock()  # so that two requests for a view decode it once
        self._record = lru_cache(KEPT_RECORDS)(source.scene)
        self._view = lru_cache(KEPT_VIEWS)(self._read_view)

    def find(self, path: str) -> tuple[bytes, str] | None:
        """Return content and type; None where there is nothing of that path. Raises `StoreError` for what is broken."""
        name = path.removeprefix("/") or "index.html"
        if name in PAGE:
            return (SITE / name).read_bytes(), PAGE[name]
        if name == "data/dataset.json":
            return dataset_json(self._source, self._source.indices, self._source.address), "application/json"
        found = re.fullmatch(r"data/scenes/(\d{6,9})/(.+)", name)
        if found is None:
            return None
        index, rest = int(found[1]), found[2]
        if index not in self._source.indices or f"data/{scene_folder(index)}/{rest}" != name:
            return None
        if rest == "scene.json":
            return scene_json(self._record(index)), "application/json"
        if rest == PREVIEW:
            return preview(self._source, index), "image/png"
        return self._view_file(index, rest)

    def _view_file(self, index: int, rest: str) -> tuple[bytes, str] | None:
        found = re.fullmatch(r"(views/(\d{2,6}))/([a-z0-9_.]+)", rest)
        if found is None or found[1] != view_folder(number := int(found[2])):
            return None
        with self._lock:
            if number >= len(self._record(index).views):
                return None
            files = self._view(index, number)
        if found[3] not in files.names():
            return None
        kind = "application/json" if found[3] == "view.json" else "application/octet-stream"
        return files.file(found[3], 0), kind

    def _read_view(self, index: int, number: int) -> ViewFiles:
        record = self._record(index)
        return ViewFiles(record, self._source.view(record, number))


class Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD of whoever names this machine as the host: a page elsewhere cannot pass for it."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "multilight", ""
    server: "Server"

    def do_GET(self) -> None:
        """Answer with the content, or with an error as JSON."""
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{LOOPBACK}:{port}", f"localhost:{port}"):
            self._fail(HTTPStatus.FORBIDDEN, "this server answers to this machine only")
            return
        try:
            found = self.server.answers.find(self.path.partition("?")[0])
        except (StoreError, OSError, MemoryError) as error:
            self._fail(HTTPStatus.INTERNAL_SERVER_ERROR, plain(str(error)))
            return
        if found is None:
            self._fail(HTTPStatus.NOT_FOUND, "there is nothing of that name")
        else:
            self._send(HTTPStatus.OK, *found)

    do_HEAD = do_GET  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing of each request."""

    def _fail(self, status: HTTPStatus, reason: str) -> None:
        self._send(status, reason.encode(), "text/plain; charset=utf-8")

    def _send(self, status: HTTPStatus, content: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content)), **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)


class Server(ThreadingHTTPServer):
    """A server of one dataset, on the loopback interface."""

    daemon_threads = True

    def __init__(self, source: DatasetSource, port: int) -> None:
        """Listen on a port; 0 takes a free one."""
        self.answers = Answers(source)
        super().__init__((LOOPBACK, port), Handler)

    @property
    def address(self) -> str:
        """The page's address."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Pass over a browser that leaves in the middle; all else is told."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


def listen(source: DatasetSource, port: int | None) -> Server:
    """Start to listen on a port, or on `PORT` or a free one; raises `UserError` where it is taken."""
    try:
        return Server(source, PORT if port is None else port)
    except OSError as error:
        if port is None:
            return Server(source, 0)
        raise UserError(f"--port {port} cannot be used: {error.strerror}; choose another, or none") from None


def open_browser(address: str) -> bool:
    """Open the page where there is a browser with a window; says whether."""
    has_window = sys.platform in ("darwin", "win32") or "DISPLAY" in environ or "WAYLAND_DISPLAY" in environ
    return has_window and webbrowser.open(address)
