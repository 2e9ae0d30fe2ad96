"""The files of an aircraft: which are read, in which order systems run, what is refused."""

from __future__ import annotations

import pytest

from tests.helpers.batch_flights import aircraft, compared, craft, refused, worst
from uqharness.batch.translate.channels import read_sources
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import find_script

ADD = "<pure_gain name='o/{}'><input>o/{}</input><gain>{}</gain></pure_gain>"


def part(tag, name, of, gain, extra=""):
    return (
        f"<{tag} name='{name}'{extra}><channel"
        f" name='c'>{ADD.format(name, of, gain)}</channel></{tag}>"
    )


DECLARED = "<system name='d'><property value='1'>o/start</property></system>"


def test_systems_run_before_the_autopilot_and_that_before_the_flight_control():
    """Whatever their order in the file: each reads what the one before has made in the same
    frame.
    """
    body = (
        part("flight_control", "last", "middle", 3)
        + part("autopilot", "middle", "first", 2)
        + DECLARED
    )
    body += (
        part("system", "first", "second", 1.5)
        + part("system", "second", "start", 1.25)
        + "<aerodynamics/>"
    )
    with craft(aircraft(body)) as made:
        tags = [system.node.attributes["name"] for system in made.sources().systems]
    assert tags == ["d", "first", "second", "middle", "last"]
    assert (
        worst(
            compared(
                aircraft(body), [f"o/{n}" for n in ("first", "second", "middle", "last")], frames=5
            )
        )
        < 1e-15
    )


@pytest.mark.parametrize("place", ["x.xml", "Systems/x.xml", "systems/x.xml"])
def test_a_system_in_a_file(place):
    body = "<system file='x'><property value='4'>o/start</property></system><aerodynamics/>"
    with craft(aircraft(body), files={place: part("system", "inside", "start", 2)}) as made:
        systems = made.sources().systems
    assert systems[0].document.path.name == "x.xml"
    assert systems[0].outer is not None


def test_sections_are_found():
    sources = read_sources(find_aircraft("espaaro"), find_script("loiter"))
    assert sources.aerodynamics is not None
    assert sources.external is not None
    assert [system.document.path.name for system in sources.systems][-1] == "espaaro.xml"
    assert sources.script.root.tag == "runscript"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("<planet/><aerodynamics/>", "<planet> is not understood"),
    ],
)
def test_refused_with_line(body, said):
    found = refused(aircraft(body))
    assert said in found
    assert "point.xml:7: " in found


def test_a_file_that_is_not_there_is_refused():
    with craft(aircraft("<aerodynamics/>")) as made:
        xml = made.root / "aircraft" / "point" / "point.xml"
        xml.write_text(aircraft("<system file='nowhere'/><aerodynamics/>"))
        with pytest.raises(BadInputError, match="nowhere"):
            made.sources()
