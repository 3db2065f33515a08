"""Z7, Z12, Z17: who may read a recording; what runs from the folder that somebody stands in."""

from __future__ import annotations

import http.client
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from vidphys.cli.view import ViewConfig, view
from vidphys.errors import InputError
from vidphys.runs import pool
from viz import viewer
from viz.served import serving

CONTENT = bytes(range(256)) * 1000
TOLD = {"title": "<a>", "told": {"seed": "</script>"}, "picture": None, "at": 0.6}


@pytest.fixture
def address(tmp_path) -> Iterator[str]:
    (tmp_path / "a b.rrd").write_bytes(CONTENT)
    with serving([tmp_path / "a b.rrd"], {"viewer.js": b"code"}, TOLD, 0) as page:
        yield f"{page}0/a%20b.rrd"


def asked(address: str, host: str | None = None, path: str | None = None, way: str = "GET",
          **headers: str) -> tuple[int, bytes, dict[str, str]]:  # fmt: skip
    parts = urlsplit(address)
    line = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=60)
    line.putrequest(way, path or parts.path, skip_host=True)
    line.putheader("Host", host or parts.netloc)
    for name, value in headers.items():
        line.putheader(name, value)
    line.endheaders()
    answer = line.getresponse()
    found = answer.status, answer.read(), dict(answer.getheaders())
    line.close()
    return found


def test_z12_who_has_the_address_reads_the_recording(address):
    status, body, headers = asked(address)
    assert (status, body) == (200, CONTENT)
    assert "Access-Control-Allow-Origin" not in headers
    port = urlsplit(address).port
    assert asked(address, f"localhost:{port}")[:2] == (200, CONTENT)


def test_z12_the_page_asks_nobody_else(address):
    page = address.removesuffix("0/a%20b.rrd")
    status, body, headers = asked(page)
    assert status == 200 and b"&lt;/script&gt;" in body and b'"files":["0/a%20b.rrd"]' in body
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "http" not in policy and "*" not in policy
    assert asked(f"{page}viewer.js")[1] == b"code"


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "0.0.0.0:{port}"]
)
def test_z12_a_page_that_rebinds_its_name_reads_nothing(address, host):
    status, body, _ = asked(address, host.format(port=urlsplit(address).port))
    assert status == 403
    assert CONTENT[:64] not in body


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_z12_no_other_origin_is_let_read(address, origin):
    assert "Access-Control-Allow-Origin" not in asked(address, Origin=origin)[2]


@pytest.mark.parametrize("path", ["/", "/0/a%20b.rrd", "/x/0/a%20b.rrd", "/../../etc/passwd", "*"])
def test_z12_without_the_token_nothing_is_found(address, path):
    assert asked(address, path=path)[0] in (400, 404)


def test_z12_the_token_is_another_each_time(tmp_path):
    (tmp_path / "a.rrd").touch()
    tokens = set()
    for _ in range(3):
        with serving([tmp_path / "a.rrd"], {}, TOLD, 0) as one:
            assert urlsplit(one).hostname == "127.0.0.1"
            tokens.add(urlsplit(one).path.split("/")[1])
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 32


def run_with(tmp_path: Path, recording: Path) -> Path:
    run = tmp_path / "run"
    (run / "recordings").mkdir(parents=True)
    (run / "recordings" / "a.rrd").symlink_to(recording)
    return run


def test_z07_a_linked_recording_is_neither_shown_nor_copied(tmp_path):
    (tmp_path / "secret").write_text("mine")
    run = run_with(tmp_path, tmp_path / "secret")
    with pytest.raises(InputError, match="a link that leads out of the run"):
        view(ViewConfig(run, save=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["file", "link", "folder"])
def test_z17_no_recording_is_written_over_what_is_there(tmp_path, kind):
    run = tmp_path / "run"
    (run / "recordings").mkdir(parents=True)
    (run / "recordings" / "a.rrd").write_bytes(b"new")
    (tmp_path / "mine.rrd").write_text("mine")
    target = tmp_path / "out" / "a.rrd"
    target.parent.mkdir()
    if kind == "link":
        target.symlink_to(tmp_path / "nowhere")
    elif kind == "file":
        target.write_text("mine")
    else:
        target.mkdir()
    for save in (target, target.parent):
        with pytest.raises(InputError, match="exists|would overwrite"):
            view(ViewConfig(run, save=save))
    assert not (tmp_path / "nowhere").exists()
    assert (tmp_path / "mine.rrd").read_text() == "mine"


def test_safe_path_the_viewer_is_not_one_from_this_folder(tmp_path, monkeypatch):
    (tmp_path / "rerun_cli").mkdir()
    for name in ("__init__.py", "__main__.py"):
        (tmp_path / "rerun_cli" / name).write_text("open('ran', 'w'); main = lambda: 0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    command = viewer._command("--version")
    assert Path(command[0]).is_absolute()
    done = subprocess.run(command, capture_output=True, timeout=60)
    assert not (tmp_path / "ran").exists()
    assert b"rerun" in done.stdout


def test_safe_path_workers_import_nothing_from_this_folder(tmp_path):
    """As `vidphys ladder` starts its workers, in a folder with a module of a library's name."""
    for name in ("multiprocessing", "torch", "numpy"):
        (tmp_path / f"{name}.py").write_text("open('ran', 'w')")
    code = "import sys; from multiprocessing.spawn import spawn_main; print(sys.flags.safe_path)"
    with pool._safe_path():
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, timeout=60
        )
    assert done.stdout.split() == [b"True"]
    assert not (tmp_path / "ran").exists()
