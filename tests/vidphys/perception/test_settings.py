"""What a rung is set to: told to the record as it is given to the fit."""

import json
from dataclasses import asdict
from functools import partial

from vidphys.perception.base import Grounding
from vidphys.perception.catalogue import ORACLE, RUNGS, rung_settings
from vidphys.perception.cnn import CnnSettings

CNN = CnnSettings()


def fit(encoder, task, rate=0.1, how=CNN):
    raise NotImplementedError


def test_a_rung_tells_all_that_its_fit_is_given_beside_the_task():
    rung = Grounding("mine", "channel", "none", "none", False, partial(fit, "tiny", rate=0.2))
    assert rung.settings == {"encoder": "tiny", "rate": 0.2, "how": asdict(CnnSettings())}
    told = Grounding("mine", "channel", "none", "none", False, partial(fit, how=CnnSettings(8)))
    assert told.settings["how"]["features"] == 8


def test_every_rung_tells_its_settings_in_json():
    found = json.loads(json.dumps(rung_settings(r for r in RUNGS.values() if r is not ORACLE)))
    assert found.keys() == {*RUNGS, "shared"} - {"oracle"}
    assert all(found.values())
    rates = [name for name in found if "learning_rate" in json.dumps(found[name])]
    assert {"cnn-supervised", "jepa", "anonymous-tracker", "anonymous-slots", "composed"} <= {
        *rates
    }
