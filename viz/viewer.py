"""The viewer as a program: opened in a window, its code for a browser, recordings merged.

It runs as a process of its own, which reads the files; nothing of rerun is imported here.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from urllib.request import urlopen

from viz.whole import whole

_LAUNCH = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
WEB_PORT = 9090
WEB_CODE = ("re_viewer.js", "re_viewer_bg.wasm")
PATIENCE = 60  # seconds that the code is waited for
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


def web_code() -> dict[str, bytes]:
    """What a page starts the viewer with: its script and its WebAssembly, by their names.

    rerun has them inside of its program, whose own server is asked for them and ended.

    Raises:
        RuntimeError: it does not hand them out.
    """
    port = free_port()
    ports = ("--port", str(free_port()), "--web-viewer-port", str(port))
    command = _command("--serve-web", "--bind", "127.0.0.1", *ports)
    environment = _quiet() | {"RUST_LOG": "error"}
    with subprocess.Popen(
        command, env=environment, start_new_session=True, stdout=subprocess.DEVNULL
    ) as started:
        try:
            return {name: _fetched(started, port, name) for name in WEB_CODE}
        finally:
            _end(started)


def _fetched(server: subprocess.Popen[bytes], port: int, name: str) -> bytes:
    """A file of rerun's server, which may only just be starting."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            with urlopen(f"http://127.0.0.1:{port}/{name}", timeout=PATIENCE) as answer:
                return answer.read()
        except OSError as error:
            if server.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"viewer: rerun does not hand out {name} ({error})") from error
            time.sleep(0.02)


def free_port(wanted: int = 0) -> int:
    """``wanted``, or any other where that is taken."""
    if wanted and _is_free(wanted):
        return wanted
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def merge(recordings: Sequence[Path], path: Path) -> None:
    """Write several recordings into one file, whole or not at all.

    Raises:
        RuntimeError: they could not be merged.
    """
    with whole(path) as part:
        command = _command("rrd", "merge", "-o", str(part), *map(str, recordings))
        done = subprocess.run(command, env=_quiet(), capture_output=True, text=True)
        _check(done.returncode, done.stderr)


def _run(command: list[str], environment: dict[str, str]) -> int:
    """Run a command until it ends or is interrupted, and give its exit code."""
    # A group of its own: rerun's launcher, ended alone, leaves the viewer that it started behind.
    with subprocess.Popen(command, env=environment, start_new_session=True) as started:
        try:
            return started.wait()
        except KeyboardInterrupt:
            _end(started)
            return INTERRUPTED


def _end(started: subprocess.Popen[bytes]) -> None:
    """End a process with all that it started."""
    if sys.platform == "win32":
        started.terminate()
    else:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(started.pid, signal.SIGTERM)


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
