"""A server for this machine alone, whose address holds a token.

A page of a stranger that the same browser shows could ask its port too, under a name of its own
that it had point here. So a request must hold the token, and name this machine.
"""

from __future__ import annotations

import secrets
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

NAMES = ("127.0.0.1", "localhost")


class Loopback(ThreadingHTTPServer):
    """On 127.0.0.1; ``token`` is the first part of every path.

    Args:
        port: where it listens; 0 takes any that is free.
        answer: what answers a request.
    """

    daemon_threads = True

    def __init__(self, port: int, answer: type[LoopbackAnswer]) -> None:
        self.token = secrets.token_urlsafe(24)
        super().__init__(("127.0.0.1", port), answer)
        self.hosts = {f"{name}:{self.server_port}" for name in NAMES}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that is closed breaks its lines off: that is no trouble of ours."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """With the token, and a slash at its end."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"


class LoopbackAnswer(BaseHTTPRequestHandler):
    """Answers those who know the token."""

    server: Loopback
    timeout = 30  # seconds that a silent client is waited for

    def asked(self) -> str | None:
        """What is asked for, after the token; a refusal is sent where it is nothing of ours."""
        if self.headers.get("Host") not in self.server.hosts:
            self.send_error(HTTPStatus.FORBIDDEN)
            return None
        start = f"/{self.server.token}/"
        given = self.path[: len(start)].encode(errors="replace")
        if not secrets.compare_digest(start.encode(), given):
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        return self.path[len(start) :]

    def guarded(self) -> None:
        """The end of every head: nothing is kept, guessed at, or told to others."""
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the address, with its token, is no line of a log."""
