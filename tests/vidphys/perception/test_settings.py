"""What a rung is set to: told to the record as it is given to the fit."""

import json
from dataclasses import asdict
from functools import partial
from types import SimpleNamespace

import pytest

from registry import RegistryError
from vidphys.perception import catalogue
from vidphys.perception.base import LABELS, NOTHING, REDRAWS, UNTOLD, Grounding
from vidphys.perception.catalogue import RUNGS, rung_of, rung_settings
from vidphys.perception.cnn import CnnSettings

CNN = CnnSettings()


def fit(encoder, task, rate=0.1, how=CNN):
    raise NotImplementedError


def test_a_rung_tells_all_that_its_fit_is_given_beside_the_task():
    seen = "mine", "channel", "none", "none", False
    rung = Grounding(*seen, partial(fit, "tiny", rate=0.2), UNTOLD, NOTHING)
    assert rung.settings == {"encoder": "tiny", "rate": 0.2, "how": asdict(CnnSettings())}
    told = Grounding(*seen, partial(fit, how=CnnSettings(8)), UNTOLD, NOTHING)
    assert told.settings["how"]["features"] == 8


def test_every_rung_tells_its_settings_in_json():
    found = json.loads(json.dumps(rung_settings(RUNGS.values())))
    assert found.keys() == {*RUNGS, "shared"}
    assert all(found.values())
    rates = [name for name in found if "learning_rate" in json.dumps(found[name])]
    assert {"cnn-supervised", "jepa", "anonymous-tracker", "anonymous-slots", "composed"} <= {
        *rates
    }


def test_a_variant_is_the_same_rung_with_other_settings():
    rung = Grounding("mine", "rgb", "e", "b", False, partial(fit, "tiny"), LABELS, REDRAWS, share=3)
    other = rung.varied("fast", UNTOLD, rate=0.5)
    assert (other.name, other.of, other.supervision, other.knows) == (
        "mine-fast",
        "mine",
        UNTOLD,
        REDRAWS,
    )
    assert other.settings == {**rung.settings, "rate": 0.5} and other.share == 3
    assert other.varied("more").of == "mine"
    assert (rung.told(12), other.told(12)) == ("labels of 12 clips", "none")


def test_a_rung_is_found_by_its_name_or_made_of_an_encoder(monkeypatch):
    assert rung_of("hiera") is RUNGS["hiera"]
    mine = Grounding("mine", "rgb", "e", "b", False, partial(fit, "tiny"), LABELS, REDRAWS)
    with pytest.raises(RegistryError, match="hiera"):
        rung_of("hierra")
    monkeypatch.setattr("tests.vidphys.perception.test_settings.MINE", mine, raising=False)
    assert rung_of("tests.vidphys.perception.test_settings:MINE") is mine
    for frames, together in ((1, 1), (2, None)):
        network = SimpleNamespace(frames_per_feature=frames)
        monkeypatch.setattr(catalogue, "load_encoder", lambda *_, network=network: network)
        made = rung_of("encoders.frozen.catalogue:load_encoder")
        assert made.world == "rgb" and made.settings["together"] == together


def test_only_anonymous_pictures_do_not_say_who_is_who():
    assert {name for name, rung in RUNGS.items() if not rung.identified} == {
        name for name, rung in RUNGS.items() if rung.world == "anonymous"
    }
    assert RUNGS["hiera"].identified and not RUNGS["composed"].identified


def test_every_rung_says_what_it_is_told_and_what_it_knows():
    told = rung_settings(RUNGS.values())
    for name, rung in RUNGS.items():
        assert rung.supervision and rung.knows
        assert (told[name]["supervision"], told[name]["knows"]) == (rung.supervision, rung.knows)
        assert not rung.of or (rung.of in RUNGS and told[name]["variant_of"] == rung.of)
    assert {name for name, rung in RUNGS.items() if rung.of == "hiera"} == {
        "hiera-anchored",
        "hiera-diff",
        "hiera-random",
    }
    assert RUNGS["hiera-anchored"].supervision == "anchor: tracker"
    blobs = {name for name in RUNGS if name.endswith("-blobs")}
    assert blobs >= {"rgb-tracked-blobs", "anonymous-slots-blobs", "composed-blobs"}
    assert all(RUNGS[name].knows.startswith("blobs") for name in blobs)
