"""The page on which a law is played with, and the desk between it and the one who rolls.

Requests come in threads of their own; what they ask is answered in the thread that calls
:meth:`Desk.work`, one at a time, and of several changes only the newest. An answer is a stream of
pieces: lengths of both parts (two unsigned 32-bit numbers, low byte first), JSON, and 32-bit floats
or the bytes of a recording.
"""

from __future__ import annotations

import json
import queue
import struct
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

import numpy as np

from viz.loopback import NAMES, Loopback, LoopbackAnswer
from viz.page import render

MOST_BYTES = 2**16  # of a question
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
Part = tuple[dict[str, Any], np.ndarray | bytes | None]
# Between parts: seconds in which a newer question is waited for.
Answering = Callable[[bytes], Iterator[Part | float]]


@dataclass
class Question:
    """What the page asks.

    Args:
        kind: of the question, the end of its path.
        body: as it came.
        reply: pieces; a text where it is refused, ``None`` at the end.
        gone: nobody waits any more.
    """

    kind: str
    body: bytes
    reply: queue.SimpleQueue[bytes | str | None] = field(default_factory=queue.SimpleQueue)
    gone: threading.Event = field(default_factory=threading.Event)


class Desk:
    """Where questions wait for the one who answers them."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[Question] = queue.Queue()

    def ask(self, question: Question) -> None:
        """Hand in a question."""
        self._waiting.put(question)

    def work(self, answers: Mapping[str, Answering]) -> None:
        """Answer until interrupted.

        Args:
            answers: by kind of question; a ValueError or RuntimeError of theirs refuses it.
        """
        while True:
            question = self._waiting.get()
            try:
                self._answer(question, answers[question.kind])
            finally:
                question.reply.put(None)

    def _answer(self, question: Question, answering: Answering) -> None:
        try:
            for part in answering(question.body):
                if isinstance(part, float):
                    self._wait(part)
                else:
                    question.reply.put(packed(*part))
                if question.gone.is_set() or not self._waiting.empty():
                    return  # somebody has changed it again
        except (ValueError, RuntimeError) as error:
            question.reply.put(" ".join(str(error).split()))

    def _wait(self, seconds: float) -> None:
        with self._waiting.not_empty:
            self._waiting.not_empty.wait_for(lambda: self._waiting.queue, seconds)


def packed(about: Mapping[str, Any], more: np.ndarray | bytes | None = None) -> bytes:
    """A piece of an answer."""
    text = json.dumps(about, allow_nan=False).encode()
    data = more or b"" if not isinstance(more, np.ndarray) else _floats(more)
    return struct.pack("<II", len(text), len(data)) + text + data


def _floats(numbers: np.ndarray) -> bytes:
    return np.ascontiguousarray(numbers, "<f4").tobytes()


@contextmanager
def play_page(
    told: dict[str, Any], port: int, kinds: tuple[str, ...]
) -> Iterator[tuple[str, Desk]]:
    """Serve the page on 127.0.0.1 while the block runs; gives its address and its desk.

    Args:
        told: what ``templates/stage.html`` says.
        port: where it is served; 0 takes any that is free.
        kinds: of questions that it may ask.

    Raises:
        OSError: the port is taken.
    """
    server = _Server(port, _Answer)
    server.page, server.desk, server.kinds = render("stage.html", told).encode(), Desk(), kinds
    server.pages = {f"http://{name}:{server.server_port}" for name in NAMES}
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.address, server.desk
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(Loopback):
    page: bytes
    desk: Desk
    kinds: tuple[str, ...]
    pages: set[str]


class _Answer(LoopbackAnswer):
    server: _Server
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = 600  # between two changes a connection stays open

    def do_GET(self) -> None:
        name = self.asked()
        if name is None:
            return
        if name:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Content-Length", str(len(self.server.page)))
        self.guarded()
        self.wfile.write(self.server.page)

    def do_POST(self) -> None:
        kind = self.asked()
        if kind is None:
            return
        body = self._body(kind)
        if body is None:
            return
        question = Question(kind, body)
        self.server.desk.ask(question)
        first = question.reply.get()
        if isinstance(first, str):
            self._refuse(HTTPStatus.BAD_REQUEST, first)
            return
        try:
            self._stream(question, first)
        except OSError:  # it was closed there
            self.close_connection = True
        finally:
            question.gone.set()

    def _body(self, kind: str) -> bytes | None:
        """Of a question of ours; a refusal is sent where it is none."""
        length = self.headers.get("Content-Length", "")
        self.close_connection = True  # what is refused is not read either
        if self.headers.get("Origin", next(iter(self.server.pages))) not in self.server.pages:
            self.send_error(HTTPStatus.FORBIDDEN)
        elif kind not in self.server.kinds:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif not length.isdecimal() or int(length) > MOST_BYTES:
            self._refuse(HTTPStatus.BAD_REQUEST, f"a question has at most {MOST_BYTES} bytes")
        else:
            self.close_connection = False
            return self.rfile.read(int(length))
        return None

    def _stream(self, question: Question, piece: bytes | str | None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Transfer-Encoding", "chunked")
        self.guarded()
        while piece is not None:
            data = packed({"role": "trouble", "said": [piece]}) if isinstance(piece, str) else piece
            self.wfile.write(b"%x\r\n%b\r\n" % (len(data), data))
            piece = question.reply.get()
        self.wfile.write(b"0\r\n\r\n")

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        data = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", "text/plain; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.guarded()
        self.wfile.write(data)
