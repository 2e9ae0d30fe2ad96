"""Orders and answers on Dask's wire: exact, plain text, and no way to have foreign code run."""

from __future__ import annotations

import json
import math
import struct
import sys
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import dask
from uqharness.campaign.dask import (
    MODULES_VARIABLE,
    OWN_FLIGHT,
    OWN_GROUP,
    Answer,
    Order,
    answer_from,
    answer_text,
    flight_function,
    flight_name,
    fly_order,
    order_from,
    order_text,
)
from uqharness.campaign.rerun import RecordedFlight
from uqharness.campaign.worker import CaseOutcome, Group, attempt, fly_group
from uqharness.errors import BadInputError
from uqharness.flight import fly as flight
from uqharness.flight.spec import FlightResult, FlightSpec, LevelDriver, TransientDriver

FLIGHT = FlightSpec(
    Path("/a/plane é"),
    Path("/b/loiter.xml"),
    0.1 + 0.2,
    burn_in_s=5e-324,
    turbulence="moderate",
    sensor_noise=True,
    seed_turbulence=2**70,
    properties={"uq/CX/level": 1 / 3, "x": -0.0, "low": -math.inf},
    excursion_radius_m=(15.0, 1e300),
    levels=LevelDriver("walk", 7, "e1", ("CX", "Cn"), (0.1, 2.5)),
    transient=TransientDriver(7, 3, ("CX", "Cm"), (0.9, 1 / 3)),
)
ORDER = Order(
    OWN_FLIGHT,
    False,
    Group("jsbsim", (("0001", FLIGHT),)),
    ("a" * 64, "b" * 64),
    (("jsbsim", "1.3.3"),),
)
OUTCOME = CaseOutcome("0001", "ok", "", 3.5, {"a": 1 / 3, "b": math.inf}, {"c": "why"})


def order_of(flight, **changes):
    return replace(ORDER, group=Group("batch", (("0001", flight),)), **changes)


def test_an_order_comes_back_as_it_was():
    back = order_from(order_text(ORDER))
    assert back == ORDER
    ((case_id, back_flight),) = back.group.cases
    assert (case_id, str(back_flight.properties["x"])) == ("0001", "-0.0")
    assert back != replace(
        ORDER, group=Group("jsbsim", (("0001", replace(FLIGHT, duration_s=0.3)),))
    )
    several = replace(
        ORDER,
        group=Group("batch", (("0001", FLIGHT), ("0002", replace(FLIGHT, seed_noise=5)))),
        together=True,
    )
    assert order_from(order_text(several)) == several
    given_so = MappingProxyType({"x": np.float64(1 / 3)})
    odd = order_of(replace(FLIGHT, properties=given_so, levels=None, seed_noise=np.int64(3)))
    assert order_from(order_text(odd)) == order_of(
        replace(FLIGHT, properties={"x": 1 / 3}, levels=None, seed_noise=3)
    )


@settings(max_examples=300, deadline=None)
@given(st.floats(allow_nan=False))
def test_every_number_comes_back_bit_for_bit(value):
    back = order_from(order_text(order_of(replace(FLIGHT, properties={"x": value}))))
    assert struct.pack("<d", back.group.cases[0][1].properties["x"]) == struct.pack("<d", value)
    (outcome,) = answer_from(
        answer_text(Answer((replace(OUTCOME, metrics={"x": value}),))), ("0001",)
    )
    assert struct.pack("<d", outcome.metrics["x"]) == struct.pack("<d", value)


def test_a_path_that_is_no_text_is_a_sentence():
    with pytest.raises(BadInputError, match="no UTF-8 cannot be sent"):
        order_text(order_of(replace(FLIGHT, aircraft=Path("/a\udc80"))))


def test_nan_is_the_same_wherever_a_case_was_flown():
    negative = struct.unpack("<d", b"\x01\x00\x00\x00\x00\x00\xf8\xff")[0]
    found = attempt(
        lambda _: FlightResult("ok", "", 1.0, {"x": negative}, {"x": "why"}, {}), "0001", FLIGHT
    )
    (back,) = answer_from(answer_text(Answer((found,))), ("0001",))
    assert struct.pack("<d", found.metrics["x"]) == struct.pack("<d", back.metrics["x"])
    assert struct.pack("<d", found.metrics["x"]) != struct.pack("<d", negative)


TEXT = order_text(ORDER)
MALFORMED = [
    "",
    "null",
    "[]",
    "{}",
    "{",
    "[" * 100_000,
    '{"case_id": "1"}',
    TEXT[:-1],
    TEXT.replace('"/b/loiter.xml"', "5"),
    TEXT.replace('"walk"', '"jump"'),
    TEXT.replace("5e-324", '"5"'),
    TEXT.replace("5e-324", "null"),
    TEXT.replace("true", '"yes"'),
    TEXT.replace('"1.3.3"]', '"1.3.3", "x"]'),
    b"\x80\x05.",
    None,
    5,
    ORDER,
]


@pytest.mark.parametrize("text", MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_order_is_one_sentence_to_the_campaign(text):
    with pytest.raises(BadInputError, match="malformed order on the Dask cluster") as error:
        order_from(text)
    assert "\n" not in str(error.value)
    with pytest.raises(
        BadInputError, match=r"Dask worker on .*: malformed order on the Dask cluster"
    ):
        answer_from(fly_order(text), ("0001",))


def test_an_answer_is_that_of_the_case_asked_for():
    text = answer_text(Answer((OUTCOME,)))
    assert answer_from(text, ("0001",)) == [OUTCOME]
    with pytest.raises(BadInputError, match="answered for case '0001'"):
        answer_from(text, ("0002",))
    with pytest.raises(BadInputError, match="answered with 1 flights; asked for were 2"):
        answer_from(text, ("0001", "0002"))
    for bad in (
        text[:-1],
        text.replace('"ok"', "3"),
        json.dumps({"outcomes": [[]]}),
        json.dumps({"outcomes": {}}),
    ):
        with pytest.raises(BadInputError, match="malformed answer"):
            answer_from(bad, ("0001",))
    with pytest.raises(BadInputError, match="status 'fine'"):
        answer_from(text.replace('"ok"', '"fine"'), ("0001",))
    with pytest.raises(BadInputError, match="other content here"):
        answer_from(answer_text(Answer(None, "other content here")), ("0001",))


def test_functions_have_names_and_other_things_have_none(tmp_path):
    assert flight_name(flight.fly) == OWN_FLIGHT
    assert flight_function(OWN_FLIGHT) is flight.fly
    assert flight_name(fly_group) == OWN_GROUP
    assert flight_function(OWN_GROUP) is fly_group
    assert flight_name(fakes.steady) == "tests.helpers.campaign_fakes:steady"
    for other in (
        lambda spec: None,
        fakes.NotThere(),
        RecordedFlight(tmp_path),
        print,
        fakes.NotThere.__call__,
    ):
        with pytest.raises(BadInputError, match="fly this campaign without --dask"):
            flight_name(other)


def test_a_worker_imports_no_module_that_its_operator_did_not_name(tmp_path, monkeypatch):
    (tmp_path / "harm.py").write_text("open('ran', 'w').close()\ndef fly(spec): pass\nnumber = 1\n")
    (tmp_path / "broken.py").write_text("raise ImportError('no such library')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    foreign = ("harm:fly", "os:system", "tests.helpers.campaign_fakes:steady", ":", "")
    for name in (
        *foreign,
        "uqharness.flight.fly:Path",
        "uqharness.cli.benchmark_loop:bare_flight",
    ):
        with pytest.raises(BadInputError, match=r"flies with uqharness\.flight\.fly:fly alone"):
            flight_function(name)
        answer = fly_order(order_text(replace(ORDER, fly=name)))
        assert "flies with uqharness.flight.fly:fly alone" in json.loads(answer)["refused"]
    assert not (tmp_path / "ran").exists()
    monkeypatch.setenv(MODULES_VARIABLE, "tests.helpers.campaign_fakes, harm,broken,absent")
    assert flight_function("tests.helpers.campaign_fakes:steady") is fakes.steady
    assert flight_function("harm:fly") is sys.modules["harm"].fly
    assert (tmp_path / "ran").exists()
    for name in (
        "harm:number",
        "harm:nothing",
        "harm:fly.__globals__",
        "tests.helpers.campaign_fakes:NotThere",
        "harm",
    ):
        with pytest.raises(BadInputError, match="there is no flight function"):
            flight_function(name)
    for name in ("broken:fly", "absent:fly"):
        with pytest.raises(BadInputError, match=r"cannot be imported: (no such library|No module)"):
            flight_function(name)
    del sys.modules["harm"]


def test_an_order_without_versions_is_refused(tmp_path):
    assert "jsbsim unknown there" in fly_order(order_text(replace(ORDER, versions=())))
    assert "no case in it" in fly_order(order_text(replace(ORDER, group=Group("jsbsim", ()))))


def test_an_order_that_no_campaign_sends_is_not_flown(monkeypatch):
    def never(*_):
        raise AssertionError("the order came to the flights")

    monkeypatch.setattr(dask, "_take_executor", never)
    case_id, item = ORDER.group.cases[0]
    for cases, reason in (
        (((case_id, item), (case_id, item)), "one case twice"),
        (((case_id, item), ("2", replace(item, script=Path("/etc/passwd")))), "several aircraft"),
        (((case_id, item), ("2", replace(item, aircraft=Path("/etc")))), "several aircraft"),
        (((case_id, replace(item, duration_s=1e300)),), r"duration_s 1e+300; allowed"),
        (((case_id, replace(item, duration_s=math.inf)),), "duration_s inf; allowed"),
        (((case_id, replace(item, burn_in_s=math.nan)),), "burn_in_s nan; allowed"),
        (((case_id, replace(item, record_rate_hz=1e12)),), "record_rate_hz 1e+12; allowed"),
    ):
        group = replace(ORDER.group, cases=cases)
        answer = json.loads(fly_order(order_text(replace(ORDER, group=group, fly=OWN_FLIGHT))))
        assert answer["outcomes"] is None
        assert reason in answer["refused"]
    group = replace(ORDER.group, engine="warp")
    refused = fly_order(order_text(replace(ORDER, group=group, fly=OWN_FLIGHT)))
    assert "engine 'warp'; allowed are batch and jsbsim" in refused
    # What a campaign sends comes as far as its files, which are not on this machine.
    sent = fly_order(order_text(replace(ORDER, fly=OWN_FLIGHT)))
    assert "is not here" in sent
