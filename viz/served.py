"""Recordings for the viewer's page, to whoever was told their address, on this machine alone.

A page of a stranger that the same browser shows could ask this port too, under a name of its own
that it had point here. So the address holds a token, and a request must name this machine.
"""

from __future__ import annotations

import secrets
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

NAMES = ("127.0.0.1", "localhost")


@contextmanager
def serving(recordings: Sequence[Path], port: int, page_port: int) -> Iterator[list[str]]:
    """Serve files on 127.0.0.1 while the block runs; gives the address of each.

    Args:
        recordings: the files.
        port: where they are served.
        page_port: where the page is that may read them.
    """
    token = secrets.token_urlsafe(24)
    paths = {f"/{token}/{k}/{quote(file.name)}": file for k, file in enumerate(recordings)}
    server = _Server(("127.0.0.1", port), _Answer, paths, page_port)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield [f"http://127.0.0.1:{server.server_port}{path}" for path in paths]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(
        self,
        address: tuple[str, int],
        answer: type[BaseHTTPRequestHandler],
        paths: Mapping[str, Path],
        page_port: int,
    ) -> None:
        super().__init__(address, answer)
        self.paths = paths
        self.hosts = {f"{name}:{self.server_port}" for name in NAMES}
        self.pages = {f"http://{name}:{page_port}" for name in NAMES}


class _Answer(BaseHTTPRequestHandler):
    server: _Server
    timeout = 30  # seconds that a silent client is waited for

    def do_GET(self) -> None:
        file = self._file()
        if file is None:
            return
        with file.open("rb") as content:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(file.stat().st_size))
            self._allow()
            shutil.copyfileobj(content, self.wfile)

    def do_OPTIONS(self) -> None:
        if self._file() is not None:
            self.send_response(HTTPStatus.NO_CONTENT)
            self.send_header("Access-Control-Allow-Methods", "GET")
            self._allow()

    def _file(self) -> Path | None:
        """What is asked for; a refusal is sent where it is nothing of ours."""
        if self.headers.get("Host") not in self.server.hosts:
            self.send_error(HTTPStatus.FORBIDDEN)
            return None
        for path, file in self.server.paths.items():
            if secrets.compare_digest(path.encode(), self.path.encode(errors="replace")):
                return file
        self.send_error(HTTPStatus.NOT_FOUND)
        return None

    def _allow(self) -> None:
        """The end of the head, in which the viewer's page alone is let read the answer."""
        origin = self.headers.get("Origin")
        if origin in self.server.pages:
            self.send_header("Access-Control-Allow-Origin", origin)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the address, with its token, is no line of a log."""
