"""Recordings for the viewer's page, to whoever was told their address, on this machine alone."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote

from viz.loopback import NAMES, Loopback, LoopbackAnswer


@contextmanager
def serving(recordings: Sequence[Path], port: int, page_port: int) -> Iterator[list[str]]:
    """Serve files on 127.0.0.1 while the block runs; gives the address of each.

    Args:
        recordings: the files.
        port: where they are served.
        page_port: where the page is that may read them.
    """
    server = _Server(port, _Answer)
    server.files = {f"{k}/{quote(file.name)}": file for k, file in enumerate(recordings)}
    server.pages = {f"http://{name}:{page_port}" for name in NAMES}
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield [server.address + name for name in server.files]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(Loopback):
    files: dict[str, Path]
    pages: set[str]


class _Answer(LoopbackAnswer):
    server: _Server

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
        name = self.asked()
        if name is None:
            return None
        if name not in self.server.files:
            self.send_error(HTTPStatus.NOT_FOUND)
        return self.server.files.get(name)

    def _allow(self) -> None:
        """The end of the head, in which the viewer's page alone is let read the answer."""
        origin = self.headers.get("Origin")
        if origin in self.server.pages:
            self.send_header("Access-Control-Allow-Origin", origin)
        self.guarded()
