"""A server on this machine that speaks as the Hugging Face hub does, and can break off."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

COMMIT = "c0ffee" + "0" * 34


@dataclass
class HubServer:
    """What the server has, and what it was asked.

    Args:
        files: by name, of its one repository.
        break_after: bytes after which the next answer is cut off, once.
        asked: method, path and range of every request.
    """

    files: dict[str, bytes]
    break_after: int | None = None
    address: str = ""
    asked: list[tuple[str, str, str | None]] = field(default_factory=list)


@contextmanager
def hub_server(files: dict[str, bytes]) -> Iterator[HubServer]:
    """Serve ``files`` as those of every repository that is asked for."""
    about = HubServer(files)

    class Handler(BaseHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.answer()

        def do_GET(self) -> None:
            self.answer()

        def answer(self) -> None:
            about.asked.append((self.command, self.path, self.headers.get("Range")))
            name = self.path.partition("?")[0].rsplit("/", 1)[-1]
            if self.path.startswith("/api/models/"):
                self.give(json.dumps({"id": "a/b", "sha": COMMIT}).encode(), {})
            elif name not in about.files:
                self.send_response(404)
                self.send_header("X-Error-Code", "EntryNotFound")
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif "/resolve/" in self.path and name.endswith(".safetensors"):
                data = about.files[name]  # a large file lies elsewhere
                self.send_response(302)
                self.send_header("Location", f"{about.address}/cdn/{name}")
                self.send_header("X-Repo-Commit", COMMIT)
                self.send_header("X-Linked-Size", str(len(data)))
                self.send_header("X-Linked-ETag", tag(data))
                self.send_header("Content-Length", "0")
                self.end_headers()
            else:
                self.give(about.files[name], {"X-Repo-Commit": COMMIT})

        def give(self, data: bytes, more: dict[str, str]) -> None:
            asked, same = self.headers.get("Range"), self.headers.get("If-Range")
            start = 0
            if asked is not None and same in (None, tag(data)):
                start = int(asked.removeprefix("bytes=").split("-")[0])
            if start >= len(data) > 0:
                self.send_error(416)
                return
            self.send_response(206 if start else 200)
            if start:
                self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
            headers = {"ETag": tag(data), "Content-Length": str(len(data) - start), **more}
            for key, value in headers.items():
                self.send_header(key, value)
            self.end_headers()
            if self.command == "HEAD":
                return
            cut, sent = about.break_after, data[start:]
            if cut is not None and cut < len(sent):
                about.break_after, sent = None, sent[:cut]
                self.close_connection = True
            self.wfile.write(sent)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    about.address = f"http://127.0.0.1:{server.server_address[1]}"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield about
    finally:
        server.shutdown()
        server.server_close()


def tag(data: bytes) -> str:
    return f'"{hashlib.sha256(data).hexdigest()}"'
