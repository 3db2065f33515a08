"""Fast paths beside their peers: how they are timed, judged, kept and gone on with."""

import json
from pathlib import Path

import pytest

import benchmarks.__main__ as command
from benchmarks import store
from benchmarks.benchmark import CARD_ROWS, ROWS
from benchmarks.match import BUILDING, BenchmarkRow, Contender, Match, _row, play
from encoders.store import FeatureStore
from vidphys.trade import timing


class Clock:
    """Time that passes where it is told to, in place of the module ``time``."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0

    def passes(self, wall: float, cpu: float) -> None:
        self.wall, self.cpu = self.wall + wall, self.cpu + cpu

    def perf_counter(self) -> float:
        return self.wall

    def process_time(self) -> float:
        return self.cpu

    def sleep(self, seconds: float) -> None:
        self.passes(seconds, 0.25)  # what a library winds up in the pause


@pytest.mark.parametrize(
    ("threads", "ours", "ratios"), [(2, 5.0, [4.0, 1.0]), (1, 8.0, [1.0, 1.0])]
)
def test_contenders_are_timed_in_turn_by_one_clock_and_held_to_their_bars(
    threads, ours, ratios, monkeypatch
):
    clock, calls = Clock(), []
    monkeypatch.setattr(timing, "time", clock)

    def waits(name: str, wall: float) -> Contender:
        def work() -> None:
            calls.append(name)
            clock.passes(wall, 1.0)

        return Contender(work, 10.0, "torch", f"{name} naps", "waking up")

    peers = {"slow": (waits("slow", 8.0), 1.5), "like": (waits("like", 2.0), 0.5)}
    rows = play(Match("row", "naps", waits("ours", 2.0), peers), 3, threads)
    assert [row.peer_computes for row in rows] == ["slow naps", "like naps"]
    assert {(row.computes, row.excludes) for row in rows} == {("ours naps", "waking up")}
    assert calls == 4 * ["ours", "slow", "like"]  # the first of each is not counted
    assert [row.ours for row in rows] == [ours, ours]  # the pause counts for the process alone
    assert [row.ratio for row in rows] == [row.low for row in rows] == ratios
    assert [row.reached for row in rows] == [
        ratio >= bar for ratio, bar in zip(ratios, (1.5, 0.5), strict=True)
    ]


def test_every_row_is_a_function_of_its_file():
    for path in (*ROWS.values(), *CARD_ROWS.values()):
        module, _, name = path.partition(":")
        text = Path(*module.split(".")).with_suffix(".py").read_text()
        assert f"\ndef {name}() -> " in text or f"\n{name} = partial(" in text, path


def test_an_interrupted_benchmark_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    row = BenchmarkRow(
        "row", "peer", "frames", 2.0, 1.0, 2.0, 1.9, 2.1, 1.0, True, "torch", 1, "cpu", 3
    )
    asked = []

    def measured(name, repeats, threads, device):
        asked.append(name)
        if asked == ["one", "two"]:
            raise KeyboardInterrupt
        return [row]

    monkeypatch.setattr(command, "ROWS", {"one": "", "two": ""})
    monkeypatch.setattr(command, "run_benchmark", measured)
    arguments = ["--quiet", "--out", str(tmp_path)]
    assert [command.main(arguments), command.main(arguments)] == [130, 0]
    assert asked == ["one", "two", "two"]
    kept = json.loads((tmp_path / "benchmark.json").read_text())
    assert list(kept["rows"]) == ["one", "two"]
    capsys.readouterr()
    assert command.main([*arguments, "--threads", "2"]) == 2
    assert "other surroundings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rows", "one-more"], "no such row; there are"),
        (["--threads", "0"], "at least one"),
        (["--device", "cuda"], "no CUDA device"),
    ],
)
def test_wrong_input_is_one_line(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert command.main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_building_pays_after_as_many_steps_as_it_saves():
    def naps(wall: float) -> Contender:
        return Contender(lambda: None, 10.0, "torch", f"{wall}")

    against = {"network": (naps(8.0), 1.0), "other": (naps(8.0), 1.0)}
    match = Match("row", "steps", naps(2.0), against, {BUILDING: 3.0}, replaces="network")
    network, other = (
        _row(match, name, [5.0, 5.0, 5.0], [1.25, 1.25, 1.25], 1, "cpu") for name in against
    )
    # 0.8 s a step against 0.2 s: 3 s are won back in five steps
    assert network.numbers["steps until building pays"] == pytest.approx(5.0)
    assert other.numbers == {BUILDING: 3.0}


def test_the_store_of_made_entries_is_one_that_extraction_would_find(tmp_path, capsys):
    store.main(tmp_path / "store", 300)
    assert "look up" in capsys.readouterr().out
    kept = FeatureStore(tmp_path / "store")
    found = kept.read(store.request(299))
    assert found is not None and tuple(found.values.shape) == (1, *store.MADE.values.shape)
    assert kept.verify() == []
