"""The viewer as a program: opened in a window, served to a browser, recordings merged.

It runs as a process of its own, which reads the files; nothing of rerun is imported here.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

_LAUNCH = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
WEB_PORT, DATA_PORT = 9090, 9876
INTERRUPTED = 130  # exit code


def has_display() -> bool:
    """Whether a window can be opened."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_window(recordings: Sequence[Path]) -> None:
    """Show recordings in the native viewer, until it is closed.

    Raises:
        RuntimeError: the viewer ended with an error.
    """
    _check(_run(_command(*map(str, recordings)), _quiet()))


def serve_page(web_port: int) -> None:
    """Serve the viewer's page on 127.0.0.1 alone, until interrupted.

    It answers whoever asks, so it is given no recording: :mod:`viz.served` has them.

    Raises:
        RuntimeError: the server ended with an error.
    """
    ports = ("--port", str(free_port()), "--web-viewer-port", str(web_port))
    command = _command("--serve-web", "--bind", "127.0.0.1", *ports)
    _check(_run(command, _quiet() | {"RUST_LOG": "warn"}))


def web_address(web_port: int, recordings: Sequence[str]) -> str:
    """Where a browser finds the page with these recordings, which are given by their addresses."""
    sources = "".join(f"url={quote(address, safe='')}&" for address in recordings)
    return f"http://127.0.0.1:{web_port}/?{sources}hide_welcome_screen"


def free_ports() -> tuple[int, int]:
    """(web page, data): the usual two, or others if one of them is taken."""
    if _is_free(WEB_PORT) and _is_free(DATA_PORT):
        return WEB_PORT, DATA_PORT
    return free_port(), free_port()


def free_port() -> int:
    """Any."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def merge(recordings: Sequence[Path], path: Path) -> None:
    """Write several recordings into one file, whole or not at all.

    Raises:
        RuntimeError: they could not be merged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    command = _command("rrd", "merge", "-o", str(part), *map(str, recordings))
    try:
        done = subprocess.run(command, env=_quiet(), capture_output=True, text=True)
        _check(done.returncode, done.stderr)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _run(command: list[str], environment: dict[str, str]) -> int:
    """Run a command until it ends or is interrupted, and give its exit code."""
    # A group of its own: rerun's launcher, ended alone, leaves the viewer that it started behind.
    with subprocess.Popen(command, env=environment, start_new_session=True) as started:
        try:
            return started.wait()
        except KeyboardInterrupt:
            if sys.platform == "win32":
                started.terminate()
            else:
                os.killpg(started.pid, signal.SIGTERM)
            return INTERRUPTED


def _command(*arguments: str) -> list[str]:
    # -P: nothing is imported from the folder that somebody stands in
    return [sys.executable, "-P", "-c", _LAUNCH, *arguments]


def _quiet() -> dict[str, str]:
    # The viewer reports usage statistics, and asks about it, except under continuous integration.
    return {**os.environ, "CI": "1"}


def _check(code: int, said: str = "") -> None:
    if code not in (0, INTERRUPTED):  # an interrupt is the way to end it
        last = said.strip().splitlines()[-1:] or [f"exit code {code}"]
        raise RuntimeError(f"viewer: {last[0]}")


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
