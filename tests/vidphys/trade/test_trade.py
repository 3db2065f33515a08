"""Measured points: fronts, choices, comparisons and profiles, and the verb that handles them."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vidphys.cli import main
from vidphys.cli.extract import ExtractConfig
from vidphys.cli.ladder import LadderConfig
from vidphys.cli.profiles import with_profile
from vidphys.cli.train import TrainConfig
from vidphys.errors import InputError
from vidphys.points.pareto import pareto
from vidphys.points.pick import Bound, pick
from vidphys.points.point import Point, read_points, write_points
from vidphys.trade.compare import compare
from vidphys.trade.measure import Job, Scale, measure
from vidphys.trade.memory import peak_bytes
from vidphys.trade.profile import profile_options, read_profile, under_profile, write_profile

positive = st.floats(1e-6, 1e6)


def point(cost: float, error: float | None, number: int = 0, **changes: object) -> Point:
    return replace(
        Point(
            front="pipeline",
            task="three bodies",
            configuration={"number": number, "readout": "shooting", "frames": None},
            cost_name="ms_per_clip",
            cost=cost,
            cost_low=0.99 * cost,
            cost_high=1.01 * cost,
            clock="cpu",
            wall=cost,
            repeats=5,
            warmup_seconds=0.5,
            peak_bytes=None,
            error_name="inversion_nmse",
            error=error,
            reference="the truth",
            seed=0,
            device="cpu",
            dtype="float32",
            threads=1,
            units={"force_evaluations": 10.0},
        ),
        **changes,
    )


pairs = st.lists(st.tuples(positive, st.none() | positive), min_size=1, max_size=12)


def points_of(some: list[tuple[float, float | None]]) -> list[Point]:
    return [point(cost, error, number) for number, (cost, error) in enumerate(some)]


def beats(a: Point, b: Point) -> bool:
    if a.error is None or b.error is None:
        return b.error is None and a.error is not None
    return a.cost <= b.cost and a.error <= b.error and (a.cost, a.error) != (b.cost, b.error)


# fronts


@given(pairs)
def test_a_front_is_what_no_point_beats(some):
    points = points_of(some)
    front = pareto(points)
    for p in points:
        beaten = p.error is None or any(beats(other, p) for other in points)
        twin = any((p.cost, p.error) == (f.cost, f.error) for f in front)
        assert twin != beaten


# choices


@given(pairs, positive)
def test_within_an_error_the_cheapest_measured_point_is_chosen(some, limit):
    points = points_of(some)
    usable = [p for p in points if p.error is not None]
    bound = Bound("inversion_nmse", limit)
    if not usable:
        with pytest.raises(InputError, match="no measured point has a finite result"):
            pick(points, bound)
        return
    (choice,) = pick(points, bound)
    assert choice.point in usable
    within = [p for p in usable if p.error <= limit]
    assert choice.met == bool(within)
    if within:
        assert choice.point.cost == min(p.cost for p in within)
        assert choice.margin >= 0
    else:
        assert choice.point.error == min(p.error for p in usable)
        assert choice.margin < 0
        assert "no measured point has" in choice.sentence


@given(pairs, positive)
def test_within_a_cost_the_most_accurate_measured_point_is_chosen(some, limit):
    usable = [p for p in points_of(some) if p.error is not None]
    if not usable:
        return
    (choice,) = pick(usable, Bound("ms_per_clip", limit))
    within = [p for p in usable if p.cost_high <= limit]
    assert choice.met == bool(within)
    best = min(within or usable, key=lambda p: p.error if within else p.cost_high)
    assert choice.point.error == best.error or choice.point.cost_high == best.cost_high


def test_every_task_has_a_choice_of_its_own():
    points = [point(1.0, 0.1), point(2.0, 0.2, task="five bodies")]
    choices = pick(points, Bound("inversion_nmse", 0.15))
    assert [c.met for c in choices] == [True, False]


@pytest.mark.parametrize("text", ["", "nmse", "nmse<0.1", "nmse<=", "nmse<=a", "<=1", "a>=1"])
def test_what_is_no_bound_is_refused(text):
    with pytest.raises(InputError, match="give a bound, such as"):
        Bound.parse(text)


def test_a_bound_is_read():
    assert Bound.parse(" inversion_nmse <= 2e-2 ") == Bound("inversion_nmse", 0.02)


def test_an_unknown_quantity_names_those_there_are():
    with pytest.raises(InputError, match="there are inversion_nmse, ms_per_clip"):
        pick([point(1.0, 0.1)], Bound("speed", 1.0))


# comparisons


@pytest.mark.parametrize(
    ("cost", "error", "back"),
    [
        (1.0, 0.1, False),
        (1.04, 0.1, False),
        (1.08, 0.1, True),
        (1.0, 0.1019, False),
        (1.0, 0.103, True),
        (0.5, 0.05, False),
        (1.0, None, True),
    ],
)
def test_a_front_moves_back_by_more_than_its_share(cost, error, back):
    (change,) = compare([point(1.0, 0.1)], [point(cost, error)])
    assert change.moved_back == back


def test_noise_that_overlaps_is_not_slower():
    wide = point(1.2, 0.1, cost_low=0.9, cost_high=1.5)
    (change,) = compare([point(1.0, 0.1)], [wide])
    assert not change.moved_back


def test_a_point_off_the_old_front_does_not_matter():
    old = [point(1.0, 0.1, 0), point(2.0, 0.2, 1)]
    changes = compare(old, [point(1.0, 0.1, 0), point(9.0, 0.9, 1)])
    assert [c.moved_back for c in changes] == [False]


def test_a_configuration_that_is_gone_is_answered_by_one_as_accurate():
    old = [point(1.0, 0.1, 0)]
    assert not compare(old, [point(0.9, 0.1, 1)])[0].moved_back
    assert compare(old, [point(1.2, 0.1, 1)])[0].moved_back
    assert compare(old, [point(0.5, 0.2, 1)])[0].moved_back


# files


@settings(max_examples=5, deadline=None)
@given(pairs)
def test_points_come_back_from_both_files(tmp_path_factory, some):
    folder, points = tmp_path_factory.mktemp("points"), points_of(some)
    write_points(folder / "points.parquet", points)
    assert read_points(folder / "points.parquet") == points
    write_profile(folder / "profile.json", {"cores": 2}, points)
    assert list(read_profile(folder / "profile.json").points) == points


LOOK = {"encoder": "hiera", "layer": 8, "resolution": 64, "dtype": "float32", "pooling": 2}


def encoder_profile(path: Path, *numbers: int) -> Path:
    points = [point(1.0, 0.1, n, front="encoders", configuration=LOOK) for n in numbers]
    write_profile(path, {}, points)
    return path


def test_a_verb_takes_its_options_from_a_measured_point(tmp_path):
    profile = encoder_profile(tmp_path / "p.json", 0)
    options = {name: value for name, value in LOOK.items() if name != "pooling"}
    assert profile_options(profile, "extract") == options
    config = under_profile(ExtractConfig((Path("a.mp4"),), Path("o")), profile, "extract")
    assert (config.encoder, config.layers, config.resolution) == ("hiera", (8,), 64)


def test_a_verb_of_several_layers_takes_the_measured_one(tmp_path):
    config = TrainConfig(Path("clips"), profile=encoder_profile(tmp_path / "p.json", 0))
    found = with_profile(config, "train")
    assert (found.encoder, found.layers, found.resolution) == ("hiera", (8,), 64)


@pytest.mark.parametrize("verb", ["rollout", "ladder", "reproduce", "diagnose"])
def test_a_verb_of_which_nothing_is_measured_says_so_in_a_line(tmp_path, capsys, verb):
    config = LadderConfig(profile=encoder_profile(tmp_path / "p.json", 0))
    assert with_profile(config, verb) is config
    said = capsys.readouterr().err
    assert said.startswith(f"{verb}: --profile") and said.count("\n") == 1


@pytest.mark.parametrize(
    "verb", ["extract", "train", "render", "rollout", "ladder", "reproduce", "diagnose"]
)
def test_every_verb_that_computes_has_the_option(verb, capsys):
    assert main([verb, "--help"]) == 0
    assert "--profile" in capsys.readouterr().out


def test_an_option_that_differs_from_the_profile_is_refused(tmp_path):
    profile = encoder_profile(tmp_path / "p.json", 0)
    config = ExtractConfig((Path("a.mp4"),), Path("o"), layers=(16,))
    with pytest.raises(InputError, match=r"layers \(8,\), and `layers` \(16,\) is given as well"):
        under_profile(config, profile, "extract")


def test_a_profile_with_several_points_is_no_choice(tmp_path):
    with pytest.raises(InputError, match="has 2 points of what extract is set by"):
        profile_options(encoder_profile(tmp_path / "p.json", 0, 1), "extract")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "vidphys profile"}'])
def test_what_is_no_profile_is_refused(tmp_path, text):
    path = tmp_path / "p.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"p\.json: "):
        read_profile(path)


# measuring


def job(seconds: float, error: float, number: int = 0, calls: list[int] | None = None) -> Job:
    def work() -> float:
        if calls is not None:
            calls.append(number)
        time.sleep(seconds)
        return error

    return Job("sleep", {"number": number}, work, lambda x: {"wrong": x}, 2.0, "none")


SCALE = Scale("sleeping", "ms_per_nap", 1e3, "wrong", "being awake")


def test_jobs_are_timed_in_turn_after_a_first_call():
    calls: list[int] = []
    jobs = [job(0.004, 0.1, 0, calls), job(0.004, 0.2, 1, calls)]
    first, second = measure(SCALE, jobs, 3, 0, "cpu")
    assert calls[-6:] == [0, 1, 0, 1, 0, 1]
    assert (first.error, second.error, first.repeats) == (0.1, 0.2, 3)
    assert 2.0 <= first.wall < 1000.0  # ms of one of its two naps
    assert first.cost_low <= first.cost <= first.cost_high


def test_a_result_that_is_not_finite_has_no_error():
    (found,) = measure(SCALE, [job(0.0, math.nan)], 3, 0, "cpu")
    assert found.error is None
    assert pareto([found]) == []


def test_too_few_repeats_are_refused():
    with pytest.raises(ValueError, match="quartiles need at least 3"):
        measure(SCALE, [job(0.0, 0.0)], 2, 0, "cpu")


def test_the_memory_of_a_call_is_seen():
    _, peak = peak_bytes(lambda: torch.ones(2**24).sum(), "cpu")
    assert peak is None or 2**25 < peak < 2**28


# the verb


@pytest.fixture
def measured(tmp_path):
    folder = tmp_path / "run"
    points = [point(10.0, 0.01, 0), point(5.0, 0.1, 1), point(20.0, 0.5, 2)]
    write_points(folder / "points.parquet", points)
    write_profile(folder / "profile.json", {"cores": 2}, points[:2])
    return folder


def test_pick_prints_a_measured_point_and_saves_it(measured, capsys):
    chosen = measured.parent / "chosen.json"
    arguments = ["trade", "--out", str(measured), "--pick", "inversion_nmse<=0.02"]
    assert main([*arguments, "--save", str(chosen)]) == 0
    assert "number 0" in capsys.readouterr().out
    content = json.loads(chosen.read_text())
    assert [p["configuration"]["number"] for p in content["points"]] == [0]
    assert content["surroundings"] == {"cores": 2}


def test_pick_never_extrapolates(measured, capsys):
    assert main(["trade", "--out", str(measured), "--pick", "inversion_nmse<=0.001"]) == 1
    assert "nothing is extrapolated" in capsys.readouterr().out


def test_compare_says_what_moved_back(measured, tmp_path, capsys):
    old = tmp_path / "old.json"
    write_profile(old, {}, [point(8.0, 0.01, 0), point(5.0, 0.1, 1)])
    assert main(["trade", "--out", str(measured), "--compare", str(old)]) == 1
    out = capsys.readouterr().out
    assert "moved back: pipeline, three bodies: number 0" in out
    assert "+25.0% time" in out
    assert "2 points of older fronts, 1 moved back" in out
    assert main(["trade", "--out", str(measured), "--compare", str(measured)]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pick", "x<=1", "--compare", "old"], "exclude each other"),
        (["--save", "p.json"], "--save goes with --pick"),
        (["--fronts", "nothing"], "no such front"),
        (["--threads", "0"], "at least one is needed"),
        (["--pick", "x<=1", "--out", "nowhere"], "nowhere"),
    ],
)
def test_wrong_input_is_one_line(arguments, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["trade", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


# fronts and report


def test_the_drawing_front_gives_points_that_the_report_shows(tmp_path):
    from vidphys.trade.context import Context, TradeSizes
    from vidphys.trade.fronts import renderers
    from viz.trade import write_trade

    sizes = TradeSizes(3, 2, 0.1, 8, (16, 32), 4, (), 1, 1)
    context = Context(sizes, 0, "cpu", None, tmp_path)
    points = measure(renderers.SCALE, list(renderers.jobs(context)), 3, 0, "cpu")
    small, large = (
        [
            p
            for p in points
            if p.configuration["image"] == size and p.configuration["antialias"] == 1
        ]
        for size in (16, 32)
    )
    assert max(p.error for p in large) < min(p.error for p in small)
    steps = {"integrator": "rk4", "dt": 0.1, "dtype": "float32", "substeps": False}
    crowd = {"bodies": 2, "evaluation": "pairs", "reach": None, "dtype": "float32"}
    points += [point(1.0, 0.1, front="rollouts", configuration=steps)]
    points += [point(1.0, None, front="forces", task="gravity, 2 bodies", configuration=crowd)]
    write_points(tmp_path / "points.parquet", points)
    write_profile(tmp_path / "profile.json", {}, pareto(points[:3]))
    about = {
        "settings": {"preset": "quick", "surroundings": {"cores": 2}},
        "skipped": [{"cell": "encoders/i3d", "reason": "its weights are not here"}],
    }
    (tmp_path / "run.json").write_text(json.dumps(about))
    text = write_trade(tmp_path).read_text()
    for said in ("us_per_frame", "not finite", "its weights are not here", "<svg", "rk4"):
        assert said in text
    stored = {"errors": {"probe_nmse": 0.0328}, "units": {"bytes": 49152.0}}
    write_points(tmp_path / "points.parquet", [replace(points[0], **stored)])
    text = write_trade(tmp_path).read_text()
    assert ", 0.0328 probe_nmse" in text and "49,152 bytes" in text and " one kind of work" in text


def test_what_a_store_keeps_of_features_has_its_bytes_and_what_is_read_from_it(tmp_path):
    from vidphys.trade.context import SIZES, Context
    from vidphys.trade.fronts import encoders, runtimes

    sizes = replace(SIZES["quick"], labelled=4, runtimes=())
    context = Context(sizes, 0, "cpu", None, tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(encoders, "CHOICES", {"dino-tiny": []})
        stored = [job for job in runtimes.jobs(context) if "store_dtype" in job.configuration]
    told = {}
    for job in stored:
        errors = job.errors(job.work())
        form = job.configuration["store_dtype"], job.configuration.get("grid")
        told[form] = job.units["bytes"], errors["feature_error"], errors["probe_nmse"]
    whole = 96 * 16 * 16
    assert told["float32", None][:2] == (4 * whole, 0)
    assert told["int8", None][0] == whole + 96 * 8 and 0 < told["int8", None][1] < 0.01
    assert told["int8", 4][0] == 96 * 16 + 96 * 8
    assert told["float16", 4][1] == pytest.approx(told["int8", 4][1], rel=0.02)
    assert told["float16", 4][1] > 10 * told["int8", None][1]
    assert told["int8", None][2] == pytest.approx(told["float32", None][2], rel=0.2)


def test_an_encoder_that_is_asked_for_is_measured_by_what_it_takes(tmp_path):
    from vidphys.trade.context import SIZES, Context
    from vidphys.trade.fronts import encoders, runtimes

    mine = "vidphys_foreign_example.encoder:Edges"  # takes neither dtype nor batch
    sizes = replace(SIZES["quick"], labelled=4, runtimes=())
    context = Context(sizes, 0, "cpu", None, tmp_path, (mine,))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(encoders, "CHOICES", {})
        jobs = list(runtimes.jobs(context))
    assert {job.task for job in jobs} == {
        f"features of {mine}{x}" for x in ("", ", from the store")
    }
    first, *stored = (job.configuration for job in jobs)
    assert first == {"encoder": mine} and {"store_dtype": "int8", "encoder": mine} in stored
    assert jobs[0].errors(jobs[0].work())["feature_error"] == 0


def test_an_encoder_that_is_asked_for_is_not_left_out(tmp_path, capsys):
    asked = ["trade", "--fronts", "runtimes", "--out", str(tmp_path / "run"), "--encoders"]
    assert main([*asked, f"hf:{tmp_path / 'none'}"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: --encoders: hf:{tmp_path}") and "no weights in such" in error
    assert not (tmp_path / "run").exists()
