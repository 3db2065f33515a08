"""A store and its copy by a URL: what is pushed is pulled, and nothing that one has is lost.

In memory, and in a local server that speaks S3 where one starts.
"""

from __future__ import annotations

import shutil
import uuid

import pytest
import torch

from encoders.remote import Remote
from encoders.store import FeatureStore
from tests.shared.stored import fill, made, request
from vidphys.cli import main

BUCKET = "features"


@pytest.fixture(scope="module")
def endpoint():
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server")
    served = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    try:
        served.start()
        host, port = served.get_host_and_port()
    except OSError as error:
        pytest.skip(f"no S3 server starts here: {error}")
    yield f"http://{host}:{port}"
    served.stop()


@pytest.fixture(params=["memory", "s3"])
def where(request, monkeypatch):
    if request.param == "memory":
        return f"memory://{uuid.uuid4().hex}/features", {}
    for name, value in (
        ("ACCESS_KEY_ID", "a"),
        ("SECRET_ACCESS_KEY", "b"),
        ("REGION", "us-east-1"),
    ):
        monkeypatch.setenv(f"AWS_{name}", value)
    options = {"endpoint_url": request.getfixturevalue("endpoint")}
    import s3fs

    bucket = f"{BUCKET}-{uuid.uuid4().hex}"
    s3fs.S3FileSystem(**options).mkdir(bucket)
    return f"s3://{bucket}/deep/features", options


def same(store, numbers):
    assert len([*store.entries()]) == len(numbers) and store.verify() == []
    return all(torch.equal(store.read(request(n)).values, made(n).values) for n in numbers)


def test_what_is_pushed_is_pulled(tmp_path, where):
    url, options = where
    store, other = fill(tmp_path / "a", range(4)), FeatureStore(tmp_path / "b")
    with pytest.raises(ValueError, match="no feature store"):
        Remote(url, **options).pull(other)
    assert Remote(url, **options).push(store) > 0 and Remote(url, **options).push(store) == 0
    assert Remote(url, **options).pull(other) > 0 and same(other, range(4))
    assert Remote(url, **options).pull(other) == 0
    fill(tmp_path / "b", range(4, 6))
    Remote(url, **options).push(other)
    Remote(url, **options).pull(store)
    assert same(store, range(6))
    store.drop(request(2).key)
    Remote(url, **options).push(store)
    Remote(url, **options).pull(other)
    assert same(other, [0, 1, 3, 4, 5])


def test_what_many_made_together_is_copied_too(tmp_path, where):
    from encoders.entry import Origin
    from encoders.parts import Part, join

    url, options = where
    store, folder = fill(tmp_path / "a", range(2)), tmp_path / "a" / "shards" / "shared-x"
    folder.mkdir(parents=True)
    for unit in range(2):
        with Part(store, folder / "work") as part:
            one = request(7 + unit)
            with part.begin([one], Origin("clip.mp4", (48, 32), made(7).times)) as entries:
                entries.add([made(7 + unit).values[0]])
            assert part.commit(folder / f"{unit:06d}", {"clips": 1})
    assert [about["clips"] for about in join(folder, 2, folder / "scratch")] == [1, 1]
    Remote(url, **options).push(store)
    other = FeatureStore(tmp_path / "b")
    Remote(url, **options).pull(other)
    assert same(other, [0, 1, 7, 8])


def test_two_that_went_different_ways_are_told(tmp_path, where):
    url, options = where
    store, other = fill(tmp_path / "a", range(2)), fill(tmp_path / "b", range(2, 4))
    Remote(url, **options).push(store)
    with pytest.raises(ValueError, match="was changed since it was last copied"):
        Remote(url, **options).push(other)
    with pytest.raises(ValueError, match="has entries that .* does not have"):
        Remote(url, **options).pull(other)
    assert same(store, range(2)) and same(other, range(2, 4))


def test_a_copy_that_broke_off_is_no_store_and_goes_on(tmp_path, monkeypatch):
    url = f"memory://{uuid.uuid4().hex}"
    store, remote, other = fill(tmp_path / "a", range(3)), Remote(url), FeatureStore(tmp_path / "b")
    put, get = remote.files.put_file, remote.files.get_file

    def breaks(call):
        def called(source, to, *more):
            if "index" in source + to:
                raise OSError("the line is cut")
            return call(source, to, *more)

        return called

    monkeypatch.setattr(remote.files, "put_file", breaks(put))
    with pytest.raises(OSError, match="cut"):
        remote.push(store)
    monkeypatch.setattr(remote.files, "put_file", put)
    with pytest.raises(ValueError, match="no feature store"):
        remote.pull(other)
    remote.push(store)
    monkeypatch.setattr(remote.files, "get_file", breaks(get))
    with pytest.raises(OSError, match="cut"):
        remote.pull(other)
    assert not [*other.entries()]
    monkeypatch.setattr(remote.files, "get_file", get)
    remote.pull(other)
    assert same(other, range(3))


def test_the_verb(tmp_path, capsys):
    fill(tmp_path / "a", range(2))
    url = (tmp_path / "there").as_uri()
    assert main(["store", "push", str(tmp_path / "a"), "--url", url]) == 0
    assert main(["store", "pull", str(tmp_path / "b"), "--url", url]) == 0
    assert "were copied to" in capsys.readouterr().out
    assert same(FeatureStore(tmp_path / "b"), range(2))
    shutil.rmtree(tmp_path / "there")
    assert main(["store", "pull", str(tmp_path / "b"), "--url", url]) == 2
    assert main(["store", "push", str(tmp_path / "a")]) == 2
    assert main(["store", "push", str(tmp_path / "a"), "--url", "nosuch://x"]) == 2
