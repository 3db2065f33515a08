"""rerun's viewer on a page of ours, with recordings, to whoever was told its address.

All of it comes from one server on this machine, and the page may ask nobody else: rerun's own page
asks for fonts, and reports what is looked at.
"""

from __future__ import annotations

import mimetypes
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote

from viz.loopback import Loopback, LoopbackAnswer
from viz.page import render

POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@contextmanager
def serving(
    recordings: Sequence[Path], code: Mapping[str, bytes], told: Mapping[str, Any], port: int
) -> Iterator[str]:
    """Serve the page on 127.0.0.1 while the block runs; gives its address.

    Args:
        recordings: the files that it opens.
        code: of the viewer, by name (:func:`viz.viewer.web_code`).
        told: what ``templates/viewer.html`` says until the viewer is there, and ``at``, seconds of
            the recordings at which they stand still at first, or ``None`` to play.
        port: where it is served; 0 takes any that is free.

    Raises:
        OSError: the port is taken.
    """
    server = _Server(port, _Answer)
    server.files = {f"{k}/{quote(file.name)}": file for k, file in enumerate(recordings)}
    at = None if told["at"] is None else round(told["at"] * 1e9)
    shown = {"files": list(server.files), "at": at}
    page = render("viewer.html", {**told, "shown": shown}).encode()
    server.kept = {"": page, **code}
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.address
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(Loopback):
    files: dict[str, Path]
    kept: dict[str, bytes]


class _Answer(LoopbackAnswer):
    server: _Server

    def do_GET(self) -> None:
        name = self.asked()
        if name is None:
            return
        if name in self.server.kept:
            content = self.server.kept[name]
            kind = mimetypes.guess_type(name)[0] or "text/html; charset=utf-8"
            self._head(kind, len(content))
            self.wfile.write(content)
        elif name in self.server.files:
            with self.server.files[name].open("rb") as file:
                self._head("application/octet-stream", self.server.files[name].stat().st_size)
                shutil.copyfileobj(file, self.wfile)
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _head(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Content-Security-Policy", POLICY)
        self.guarded()
