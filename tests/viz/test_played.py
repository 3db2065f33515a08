"""The page that is played on: who may ask, what is refused, only the newest is answered."""

import http.client
import json
import struct
import threading
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest

from viz.loopback import Loopback, LoopbackAnswer
from viz.played import MOST_BYTES, Desk, Question, packed, play_page

TOLD = {"title": "Play", "folder": "run", "cells": ["a/b"]}


@contextmanager
def a_page(answers):
    """A page whose questions are answered in a thread of their own."""
    with play_page(TOLD, 0, tuple(answers)) as (address, desk):
        threading.Thread(target=desk.work, args=(answers,), daemon=True).start()
        yield address


def echo(body):
    if body == b"no":
        raise ValueError("play: nothing\n of the kind")
    yield {"role": "model", "body": body.decode()}, np.array([1.5, -2.0])
    if body == b"late":
        raise RuntimeError("it did not converge")


def asked(address, path="roll", body=b"{}", way="POST", host=None, **headers):
    parts = urlsplit(address)
    line = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=60)
    line.putrequest(way, path if path.startswith("/") else parts.path + path, skip_host=True)
    line.putheader("Host", host or parts.netloc)
    for name, value in {"Content-Length": str(len(body)), **headers}.items():
        line.putheader(name, value)
    line.endheaders(body)
    answer = line.getresponse()
    found = answer.status, answer.read(), dict(answer.getheaders())
    line.close()
    return found


def pieces(data):
    found = []
    while data:
        text, numbers = struct.unpack("<II", data[:8])
        about, data = json.loads(data[8 : 8 + text]), data[8 + text :]
        found.append((about, np.frombuffer(data[:numbers], "<f4")))
        data = data[numbers:]
    return found


def test_an_answer_is_a_stream_of_pieces():
    with a_page({"roll": echo}) as address:
        status, body, headers = asked(address, body=b"it")
    assert status == 200 and headers["Cache-Control"] == "no-store"
    ((about, numbers),) = pieces(body)
    assert about == {"role": "model", "body": "it"} and numbers.tolist() == [1.5, -2.0]


def test_what_is_wrong_is_one_line_before_or_within_an_answer():
    with a_page({"roll": echo}) as address:
        assert asked(address, body=b"no")[:2] == (400, b"play: nothing of the kind")
        status, body, _ = asked(address, body=b"late")
    assert status == 200
    assert pieces(body)[-1][0] == {"role": "trouble", "said": ["it did not converge"]}


def test_the_page_lets_nothing_in_from_elsewhere():
    with a_page({"roll": echo}) as address:
        status, body, headers = asked(address, "", way="GET", body=b"")
    assert status == 200 and b"a/b" in body
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert b"http://" not in body and b"https://" not in body


@pytest.mark.parametrize(
    ("wrong", "status"),
    [
        ({"host": "evil.example"}, 403),
        ({"host": "127.0.0.1"}, 403),
        ({"path": "/roll"}, 404),
        ({"path": "/x/roll"}, 404),
        ({"path": "other"}, 404),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Content-Length": str(MOST_BYTES + 1)}, 400),
        ({"Content-Length": "-1"}, 400),
        ({"way": "PUT"}, 501),
    ],
)
def test_strangers_are_refused(wrong, status):
    def never(_body):
        raise AssertionError("answered")
        yield

    with a_page({"roll": never}) as address:
        assert asked(address, **wrong)[0] == status


def test_of_several_changes_only_the_newest_is_answered_to_its_end():
    desk, rolled, changed = Desk(), [], threading.Event()

    def slowly(body):
        for k in range(100):
            rolled.append((body, k))
            yield {"k": k}, None
            changed.wait(60)

    threading.Thread(target=desk.work, args=({"roll": slowly},), daemon=True).start()
    first, second = Question("roll", b"1"), Question("roll", b"2")
    desk.ask(first)
    assert first.reply.get(timeout=60) is not None
    desk.ask(second)
    changed.set()
    while second.reply.get(timeout=60) is not None:
        pass
    assert rolled[-1] == (b"2", 99)
    assert sum(body == b"1" for body, _ in rolled) <= 2  # the one at work ends first


@pytest.mark.parametrize(("error", "told"), [(ConnectionResetError, False), (KeyError, True)])
def test_a_browser_that_is_closed_is_no_error(error, told, capsys):
    with Loopback(0, LoopbackAnswer) as server:
        try:
            raise error
        except error:
            server.handle_error(None, ("127.0.0.1", 1))
    assert bool(capsys.readouterr().err) == told


def test_numbers_that_are_none_are_no_numbers_of_json():
    with pytest.raises(ValueError, match="JSON"):
        packed({"x": float("nan")})
